"""The commands of `glrender`, a file each: `add_arguments(parser)` and `run(arguments)`."""
