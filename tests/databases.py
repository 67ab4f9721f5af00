"""Databases for tests: an SQLite file, and a PostgreSQL server of its own in a temporary folder."""

from __future__ import annotations

import contextlib
import glob
import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import uuid
from pathlib import Path

import pytest


def _programs():
    """Folder of initdb and postgres, or None; Debian keeps them off the search path."""
    for program in [shutil.which("initdb"), *sorted(glob.glob("/usr/lib/postgresql/*/bin/initdb"), reverse=True)]:
        if program and os.path.exists(os.path.join(os.path.dirname(os.path.realpath(program)), "postgres")):
            return os.path.dirname(os.path.realpath(program))
    return None


def _absent(reason):
    if os.environ.get("CROSSCHECK_NO_SKIP") == "1":
        pytest.fail(f"{reason}, and CROSSCHECK_NO_SKIP=1 allows no skip")
    pytest.skip(reason)


def _unprivileged():
    """Prefix of the server's commands, which root must not run, and the user who then runs them."""
    if os.geteuid() != 0:
        return [], None
    for name in ("postgres", "nobody"):
        with contextlib.suppress(KeyError):
            user = pwd.getpwnam(name)
            return ["setpriv", f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"], user
    return None, None


@pytest.fixture(scope="session")
def postgresql_server():
    """URL of the server's maintenance database; the server ends with the session."""
    programs = _programs()
    if programs is None:
        _absent("no PostgreSQL server on this machine (Debian: apt-get install postgresql)")
    before, user = _unprivileged()
    if before is None or (before and shutil.which("setpriv") is None):
        _absent("PostgreSQL does not run as root, and there is no other user to run it")
    # not in pytest's folders: every session closes them to others, and the server's user has to pass through
    folder = Path(tempfile.mkdtemp(prefix="postgresql-"))
    if user is not None:
        os.chown(folder, user.pw_uid, user.pw_gid)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data = folder / "data"

    def run(*words):
        done = subprocess.run([*before, *words], capture_output=True, text=True, timeout=60, cwd=folder)
        assert done.returncode == 0, done.stdout + done.stderr

    run(f"{programs}/initdb", "-D", str(data), "-U", "tester", "--auth=trust", "--no-sync", "-E", "UTF8", "--locale=C")
    run(f"{programs}/pg_ctl", "-D", str(data), "-l", str(folder / "log"), "-w", "-o",
        f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off", "start")
    yield f"postgresql://tester@127.0.0.1:{port}/postgres"
    run(f"{programs}/pg_ctl", "-D", str(data), "-m", "immediate", "-w", "stop")
    shutil.rmtree(folder)


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    """URL of an empty database."""
    return f"sqlite:///{tmp_path / 'some.sqlite'}" if request.param == "sqlite" else on_server(request)


def on_server(request):
    """URL of an empty database of the server."""
    import psycopg

    server, name = request.getfixturevalue("postgresql_server"), f"test_{uuid.uuid4().hex[:12]}"
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return server.rsplit("/", 1)[0] + f"/{name}"
