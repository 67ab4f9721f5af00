"""Sweeps: many scenes, parameters and perturbed members, each with many engines, on one machine or a cluster.

One run of a sweep is a cell. `plan` reads and checks the request, `members` makes the scenes, `cells` runs them in a
worker, `job` distributes the work and keeps the results, and `summary` counts them.
"""
