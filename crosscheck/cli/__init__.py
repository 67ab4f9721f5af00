"""The command line: `app` is the command; every subcommand has its own file."""
