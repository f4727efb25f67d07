"""The commands of `magphonon`, a module each, with `HELP`, `add_arguments(parser)` and `run(options)`.

They say what a shell sees: read a scene, run, write files whole, print.  Heavy imports happen inside `run`, so that
the command starts at once.
"""
