"""The command line: `app` is the command, and every subcommand has a file of its own."""
