"""The table of rows: what was computed once, by a digest of all that it depends on, and the sessions that computed it.

A row is the result of one task. It is on the disk before the command goes on, so that a kill loses only the tasks at
work. A later command finds the row by its key; a fresh one only rows of its own session. Speed is a sample of a session
and counts in no other.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import platform
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import psutil
import sqlalchemy as sql

from crosscheck.errors import ArgumentError
from crosscheck.files import cache_folder, digest, scalar
from crosscheck.jobs.database import database

VARIABLE = "CROSSCHECK_TABLE"

Reuse = Literal["rows", "any rows", "samples"]
"""What counts as a result: rows of any session, or of this one if it is fresh; rows of any session; what this session
measured, or if it has computed nothing, what was measured when the same was asked before."""

MOST_BYTES = 2 * 2**30
"""Size of all results above which those of the oldest sessions are removed."""

_METADATA = sql.MetaData()
SESSIONS = sql.Table(  # the numbers in the names grow with the format: another release makes tables of its own
    "sessions_1", _METADATA, sql.Column("id", sql.Integer, primary_key=True),
    sql.Column("ask", sql.Text, nullable=False, index=True), sql.Column("command", sql.Text, nullable=False),
    sql.Column("machine", sql.Text, nullable=False), sql.Column("process", sql.Text, nullable=False),
    sql.Column("started", sql.Text, nullable=False), sql.Column("ended", sql.Text),
    sql.Column("seconds", sql.Float, nullable=False))
ROWS = sql.Table(
    "rows_1", _METADATA, sql.Column("key", sql.String(64), primary_key=True),
    sql.Column("session", sql.ForeignKey(SESSIONS.c.id), primary_key=True, index=True),
    sql.Column("stage", sql.Text, nullable=False), sql.Column("size", sql.Integer, nullable=False),
    sql.Column("written", sql.Text, nullable=False),
    sql.Column("result", sql.LargeBinary, nullable=False))  # the last: sizes are summed without reading results


class Table:
    """The rows and sessions in an SQLite file or a PostgreSQL database. Several commands may use it at once."""

    def __init__(self, engine: sql.Engine, trouble: str = "") -> None:
        self.engine, self.trouble = engine, trouble

    @classmethod
    def opened(cls) -> Table:
        """The table named by CROSSCHECK_TABLE (a path or a URL), else `rows.sqlite` in the cache folder.

        If the latter cannot be used, `trouble` says why, and rows are kept as long as the process.

        Raises
        ------
        ArgumentError
            The table named by the user cannot be used.
        """
        where = os.environ.get(VARIABLE)
        try:
            return cls(database(where or cache_folder() / "rows.sqlite", VARIABLE, _METADATA, _prepare))
        except ArgumentError as error:
            if where:
                raise
            engine = sql.create_engine("sqlite://", poolclass=sql.StaticPool)
            _METADATA.create_all(engine)
            return cls(engine, f"{error}; results are kept for this command only")

    @contextlib.contextmanager
    def session(self, ask: str, command: str, types: Mapping[str, Any], fresh: bool = False) -> Iterator[Session]:
        """A session of a command, which continues the last one of the same `ask` if that was killed.

        It ends with the context. An error or an interrupt leaves it to be continued.

        Parameters
        ----------
        ask : digest of what is asked
        types : of the results of each stage, for `msgspec`
        fresh : rows of other sessions do not count
        """
        self._evict()
        session = Session(self, ask, command, types, fresh)
        try:
            yield session
        except BaseException:
            with contextlib.suppress(ArgumentError, sql.exc.SQLAlchemyError):  # another error was first
                session.update(process="")
            raise
        session.update(ended=_now(), seconds=session.seconds)

    def holds(self, stage: str, keys: Sequence[str]) -> set[str]:
        """Those of many keys that any session has a result for."""
        with self.engine.connect() as connection:
            return {key for some in _chunks(keys) for key in connection.execute(
                sql.select(ROWS.c.key).where(ROWS.c.stage == stage, ROWS.c.key.in_(some))).scalars()}

    def writing(self) -> contextlib.AbstractContextManager[sql.Connection]:
        """One transaction that writes."""
        return self.engine.execution_options(writes=True).begin()

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

    def _evict(self) -> None:
        """Remove the rows of the oldest ended sessions while all are larger than `MOST_BYTES`."""
        with self.writing() as connection:
            sizes = connection.execute(sql.select(ROWS.c.session, sql.func.sum(ROWS.c.size)).join(SESSIONS).where(
                SESSIONS.c.ended.is_not(None)).group_by(ROWS.c.session).order_by(ROWS.c.session)).all()
            above = sum(size for _, size in sizes) - MOST_BYTES
            for session, size in sizes:
                if above <= 0:
                    break
                connection.execute(sql.delete(ROWS).where(ROWS.c.session == session))
                above -= size


class Session:
    """One asking. What it reuses of others is rows; times are samples, which other sessions cannot know."""

    def __init__(self, table: Table, ask: str, command: str, types: Mapping[str, Any], fresh: bool) -> None:
        self._table, self._types, self.fresh = table, types, fresh
        self._opened = time.perf_counter()
        self._spent: float  # s, before this process
        self.reused, self.written = 0, 0  # rows of other sessions that this process has read, and its own
        self.since: str | None = None  # UTC, when the oldest of the reused rows was computed
        machine = platform.node()
        self._own = SESSIONS.c.ask == ask, SESSIONS.c.machine == machine
        with table.writing() as connection:
            last = connection.execute(sql.select(SESSIONS).where(*self._own).order_by(SESSIONS.c.id.desc()).limit(1)
                                      .with_for_update()).first()  # so that of two commands one continues it
            self.continued = last is not None and last.ended is None and not _alive(last.process)
            if last is not None and self.continued:
                self._id, self._spent, self.started = last.id, last.seconds, last.started
                connection.execute(sql.update(SESSIONS).where(SESSIONS.c.id == last.id).values(process=_process()))
            else:
                self._spent, self.started = 0.0, _now()
                key = connection.execute(sql.insert(SESSIONS).values(
                    ask=ask, command=command, machine=machine, process=_process(), started=self.started,
                    seconds=0.0)).inserted_primary_key
                assert key is not None
                self._id = key[0]
            self.left: int = connection.execute(sql.select(sql.func.count()).select_from(ROWS).where(
                ROWS.c.session == self._id)).scalar_one()

    @property
    def seconds(self) -> float:
        """Time (s) spent on this session so far, before kills too."""
        return self._spent + time.perf_counter() - self._opened

    @property
    def token(self) -> str:
        """Four letters that tell sessions of the same second on other machines apart."""
        return digest(platform.node(), self._id, self.started)[:4]

    def get(self, stage: str, key: str, ever: bool = False) -> Any:
        """The result of a task, or None if it has to be computed. `ever`: of any session, even if this one is fresh."""
        return self.kept(stage, [key], "any rows" if ever else "rows").get(key)

    def kept(self, stage: str, keys: Sequence[str], reuse: Reuse = "rows") -> dict[str, Any]:
        """The results that need not be computed, by their keys, the newest of each."""
        own = ROWS.c.session == self._id
        found = self._read(stage, keys, *[own] * (reuse == "samples" or (reuse == "rows" and self.fresh)))
        if reuse == "samples" and not (found or self.written or self.fresh):
            before = sql.select(SESSIONS.c.id).where(*self._own, SESSIONS.c.ended.is_not(None))
            found = self._read(stage, keys, ROWS.c.session.in_(before))
        return found

    def _read(self, stage: str, keys: Sequence[str], *where: sql.ColumnElement[bool]) -> dict[str, Any]:
        wanted = sql.select(ROWS).where(ROWS.c.stage == stage, *where).order_by(ROWS.c.session)
        with self._table.engine.connect() as connection:
            rows = {row.key: row for some in _chunks(keys)
                    for row in connection.execute(wanted.where(ROWS.c.key.in_(some)))}
        results = {key: self._typed(stage, row.result) for key, row in rows.items()}
        others = [row.written for key, row in rows.items() if row.session != self._id and results[key] is not None]
        self.reused += len(others)
        self.since = min([*others, *filter(None, [self.since])], default=None)
        return {key: result for key, result in results.items() if result is not None}

    def put(self, stage: str, key: str, result: object) -> Any:
        """Write a result and return it as `get` returns it, so that a continued command sees the same values."""
        return self._typed(stage, self.put_all(stage, {key: result})[0])

    def put_all(self, stage: str, results: Mapping[str, object]) -> list[bytes]:
        """Write results by their keys in one transaction, and return their contents."""
        contents = [zlib.compress(msgspec.msgpack.encode(result, enc_hook=scalar), 1) for result in results.values()]
        rows = [{"key": key, "session": self._id, "stage": stage, "result": content, "size": len(content),
                 "written": _now()} for key, content in zip(results, contents, strict=True)]
        with self._table.writing() as connection:
            for some in _chunks(list(results)):
                connection.execute(sql.delete(ROWS).where(ROWS.c.session == self._id, ROWS.c.key.in_(some)))
            connection.execute(sql.insert(ROWS), rows)
            connection.execute(sql.update(SESSIONS).where(SESSIONS.c.id == self._id).values(seconds=self.seconds))
        self.written += len(rows)
        return contents

    def update(self, **values: object) -> None:
        """Change what the table says of this session: one that has no process is continued by the next of its ask."""
        with self._table.writing() as connection:
            connection.execute(sql.update(SESSIONS).where(SESSIONS.c.id == self._id).values(**values))

    def _typed(self, stage: str, content: bytes) -> object:
        """The result; None if the disk has changed it, so that it is computed anew."""
        try:
            return msgspec.msgpack.decode(zlib.decompress(content), type=self._types[stage], strict=False)
        except (zlib.error, msgspec.DecodeError):
            return None


def _prepare(engine: sql.Engine) -> None:
    if engine.dialect.name == "sqlite":
        sql.event.listen(engine, "connect", _fast)
        if engine.url.database:  # readable by its user alone, as it holds whole command lines
            Path(engine.url.database).touch(mode=0o600)


def _fast(connection: Any, _: object) -> None:
    """Use a write-ahead log, where the disk can: readers never wait, and a write is one append."""
    if connection.execute("PRAGMA journal_mode = WAL").fetchone()[0] == "wal":
        connection.execute("PRAGMA synchronous = NORMAL")  # a kill loses nothing, a power cut the last rows


def _chunks(keys: Sequence[str]) -> Iterator[Sequence[str]]:
    """Groups of keys, each few enough for one statement."""
    return (keys[start:start + 500] for start in range(0, len(keys), 500))


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _process() -> str:
    """This process, so that another one with the same number is not taken for it."""
    return f"{os.getpid()} {psutil.Process().create_time():.2f}"


def _alive(process: str) -> bool:
    try:
        number, began = process.split()
        return f"{psutil.Process(int(number)).create_time():.2f}" == began
    except (ValueError, psutil.Error):  # an empty text: it has left the session
        return False
