"""Errors of lieeuler."""

from __future__ import annotations


class LieEulerError(Exception):
    """Base of all errors of lieeuler. The message is written for the user."""


class ArgumentError(LieEulerError, ValueError):
    """An argument is wrong. The message names it and says what is allowed."""
