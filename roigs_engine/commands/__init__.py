"""The commands of `python -m roigs_engine`, one file each.

Every command module has `HELP`, `EXAMPLES`, `add_arguments(parser)` and `run(args, console)`.
"""
