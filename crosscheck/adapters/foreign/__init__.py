"""Engines from outside: classes of the user's own, and other versions in environments of their own."""
