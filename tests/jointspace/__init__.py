"""Tests of crosscheck.jointspace."""
