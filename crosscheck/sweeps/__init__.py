"""Sweeps: many scenes, parameters and perturbed members, each with many engines, on one machine or a cluster.

`plan` reads and checks what is asked for, `members` makes its scenes, `cells` runs them in a worker, `parts` keeps
results on the disk, `execution` hands out the work, `job` is the sweep itself.
"""
