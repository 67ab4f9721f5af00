"""The command line: `app` is the command; every subcommand has its own file."""

from crosscheck.jobs import threads

threads.limit()  # here, because the subcommands import NumPy
