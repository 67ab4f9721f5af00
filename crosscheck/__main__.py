"""`python -m crosscheck` is the command `crosscheck`."""

from crosscheck.cli.app import main

main()
