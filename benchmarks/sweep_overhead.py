"""What a sweep costs besides truth and runs, on processes of this machine and on a local Dask cluster.

Run with `python -m benchmarks.sweep_overhead`. Cells are members of single pendulums, eight ways each, 0.5 s of motion
in 4 or 8 steps. Every place has a folder of its own, and its second run may compute nothing. `--folder` keeps the
results: a measurement that was ended goes on there with the same command.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

PLACES = ("processes", "dask")
WAYS, STARTS = 8, 5


def request(cells: int, mujoco: bool) -> dict[str, object]:
    """A sweep of about so many cells, of lieeuler alone or also of MuJoCo."""
    engines = {"lieeuler": ["DAE1L_LSE", "rattle2"], "mujoco": ["RK4", "Euler"]} if mujoco else {
        "lieeuler": ["DAE1L_LSE", "DAE2H_LSE", "rattle2", "rkmk4"]}
    return {"scenes": ["single_pendulum"], "samples": 6, "duration": 0.5, "steps": [0.125, 0.0625], "engines": engines,
            "parameters": {"bodies.pendulum.mass": [0.8, 0.9, 1.0, 1.1, 1.2]},
            "perturb": {"angular_velocity": 1e-2, "count": max(1, cells // (WAYS * STARTS)), "seed": 7}}


def free_port() -> int:
    """A port of this machine that nothing listens on."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextlib.contextmanager
def dask_cluster(folder: Path, port: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The address of a scheduler with two workers on this machine, and the processes of both."""
    address = f"tcp://127.0.0.1:{port}"
    commands = [["distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard"],
                ["distributed.cli.dask_worker", address, "--nthreads", "1", "--nworkers", "2", "--no-dashboard"]]
    running = [subprocess.Popen([sys.executable, "-m", *command], cwd=folder, stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL) for command in commands]
    try:
        time.sleep(10)  # until both workers have registered
        yield address, running
    finally:
        for process in reversed(running):
            process.terminate()
            process.wait()


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    import pandas as pd

    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweep_overhead", description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=2000, help="(default: 2000)")
    parser.add_argument("--places", nargs="+", choices=PLACES, default=PLACES, help="(default: both)")
    parser.add_argument("--mujoco", action="store_true", help="half of the ways are MuJoCo's")
    parser.add_argument("--folder", type=Path, help="keep the results here")
    options = parser.parse_args(arguments)
    frames = []
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = options.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        for place in options.places:
            scheduler = stack.enter_context(dask_cluster(folder, free_port()))[0] if place == "dask" else None
            asked = request(options.cells, options.mujoco)
            frames += [measured(place, asked, folder, scheduler) for _ in range(2)]
    for frame in frames[1:]:
        pd.testing.assert_frame_equal(frame, frames[0], check_exact=True)
    print(f"{len(frames)} frames are identical to the last bit")


def measured(place: str, asked: dict[str, object], folder: Path, scheduler: str | None) -> object:
    """Run or continue the sweep, and print what it took."""
    import crosscheck

    began = time.process_time()
    frame = crosscheck.sweep(asked, scheduler=scheduler, out=folder / place)
    report, seconds = frame.attrs["report"], time.process_time() - began
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{place}: {report['computed']} of {len(frame)} cells computed in {report['seconds']:.1f} s; "
          f"{(frame['status'] == 'success').sum()} succeeded; the client took {seconds:.1f} s of CPU "
          f"and at most {memory:.0f} MB", flush=True)
    if report["computed"]:
        print(f"  of all workers truth {report['truth_seconds']:.1f} s, runs {report['run_seconds']:.1f} s, the rest "
              f"{1e3 * report['overhead']:.2f} ms a cell", flush=True)
    return frame


if __name__ == "__main__":
    main()
