"""The command `magphonon`: `main` reads the command line; each subcommand is the module of the same name."""
