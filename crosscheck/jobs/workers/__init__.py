"""Engine runs in processes of their own, watched: what crashes, hangs or eats memory there ends as a recorded `Crash`.

`process` holds the parent's side, `child` the worker's, `output` what a worker may ask about its own printing. The same
protocol serves a worker of this installation and one in another Python environment
(`crosscheck.adapters.foreign.versions`).
"""
