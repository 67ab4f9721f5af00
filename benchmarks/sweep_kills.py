"""Sweeps whose workers, scheduler or client are killed at random end with the bits of an undisturbed run.

Run with `python -m benchmarks.sweep_kills`; `--rounds` kills of each kind before the sweep has ended. Clients and
workers of this machine are killed by SIGKILL, then the same command runs again if it has to; a Dask scheduler is killed
and started again at its address, and the same command goes on.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

SWEEP = {"scenes": ["single_pendulum"], "engines": {"lieeuler": ["DAE1L_LSE", "rattle2"]}, "steps": [1e-3, 5e-4],
         "samples": 6, "duration": 1.0, "perturb": {"angular_velocity": 1e-3, "count": 100, "seed": 7}}


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


def start(request: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    """The command line of the sweep."""
    command = [sys.executable, "-m", "crosscheck", "study", "sweep", str(request), "-o", str(out), *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def finish(request: Path, out: Path, *more: str) -> int:
    """Run the command until it succeeds; how often it was started."""
    for count in range(1, 20):
        if start(request, out, *more).wait() == 0:
            return count
    raise RuntimeError("the sweep does not end")


def worker_of(client: int) -> Any:
    """A worker process below a client, or None."""
    import psutil

    try:
        found = psutil.Process(client).children(recursive=True)
    except psutil.Error:
        return None
    return random.choice(found) if found else None


def kill_client(request: Path, out: Path, after: float) -> bool:
    """Kill the client; finish. Whether it was still running then, as below."""
    process = start(request, out)
    time.sleep(after)
    running = process.poll() is None
    process.kill()
    process.wait()
    finish(request, out)
    return running


def kill_worker(request: Path, out: Path, after: float) -> bool:
    """Kill one of the client's workers; the same client has to finish."""
    process = start(request, out)
    time.sleep(after)
    while (worker := worker_of(process.pid)) is None and process.poll() is None:
        time.sleep(0.05)  # a busy machine starts the first worker late
    if worker is not None:
        worker.kill()
    if process.wait() != 0:
        raise RuntimeError("the client did not survive its worker")
    return worker is not None


def kill_scheduler(request: Path, out: Path, after: float) -> bool:
    """Kill a Dask scheduler and start another one at the same address; finish."""
    port = free_port()
    with dask_cluster(out.parent, port) as (address, cluster):
        process = start(request, out, "--scheduler", address)
        time.sleep(after)
        running = process.poll() is None
        cluster[0].kill()
        process.wait()
    with dask_cluster(out.parent, port) as (address, _):
        finish(request, out, "--scheduler", address)
    return running


KILLS = {"client": kill_client, "worker": kill_worker, "scheduler": kill_scheduler}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    import pandas as pd

    import crosscheck

    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweep_kills", description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=10, help="kills of each kind (default: 10)")
    parser.add_argument("--kind", choices=list(KILLS), action="append", help="default: all")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        request = folder / "sweep.json"
        request.write_text(json.dumps(SWEEP))
        began = time.perf_counter()
        quiet = crosscheck.sweep(request, out=folder / "quiet")
        length = time.perf_counter() - began + 2.0
        for kind in options.kind or KILLS:
            same = killed = tried = 0
            while killed < options.rounds:  # a kill after the end of the sweep is none
                out = folder / f"{kind}{tried}"
                killed += KILLS[kind](request, out, random.uniform(0.5, length))
                tried += 1
                frame = crosscheck.sweep(request, out=out)
                pd.testing.assert_frame_equal(quiet, frame, check_exact=True)
                same += frame.attrs["report"]["computed"] == 0
            print(f"{kind} killed {killed} times in {tried} sweeps of {len(quiet)} cells: {same} of these sweeps ended "
                  "with the same bits", flush=True)


if __name__ == "__main__":
    main()
