"""Scenes in joint coordinates: inverse dynamics, derivatives of accelerations and flows, modes."""
