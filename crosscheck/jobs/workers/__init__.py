"""Worker processes for engine runs. A run that crashes, hangs or takes too much memory ends as a recorded `Crash`.

`process` is the parent's side and `child` the worker's; `frames` go between them. The protocol is
the same for workers in another Python environment (`crosscheck.adapters.external.versions`).
"""
