"""The commands of `crosscheck` that have a module of their own, one function each."""
