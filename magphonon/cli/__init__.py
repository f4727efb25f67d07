"""The command `magphonon`: `main` reads the command line, each command has a module of its name."""
