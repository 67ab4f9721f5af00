"""Scenes: what a mechanical system is, its file format, its checks and its mechanics."""
