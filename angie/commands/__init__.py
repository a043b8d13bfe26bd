"""The subcommands of `angie`, a module for each group.

The modules behind a command are imported when it runs, so that `angie --help` is quick.
"""
