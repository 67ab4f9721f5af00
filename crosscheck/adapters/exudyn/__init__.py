"""Exudyn: adapter, models of bodies with joints, kinematic trees, solver settings."""
