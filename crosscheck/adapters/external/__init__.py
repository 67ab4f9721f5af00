"""Engines from outside: classes of the user, and other versions of engines in separate environments."""
