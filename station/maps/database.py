"""The index of the map store in SQLite or PostgreSQL: transactions, migrations, and sentences for what goes wrong."""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sqlalchemy import BigInteger, Column, Integer, MetaData, String, Table, Text, create_engine, event, inspect, text
from sqlalchemy.engine import URL, Connection, Engine, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError, OperationalError
from sqlalchemy.exc import DataError as NotStorable
from sqlalchemy.pool import NullPool

from shared.advice import install
from shared.bounded import open_file, shown
from shared.disk import lock
from shared.errors import ConfigError, DataError
from station.files.unwritable import Unwritable, cannot_write, why_unwritable
from station.maps.sqlite_header import STAMP, why_foreign

LOCK = ".lock"  # in the store's folder
REVISIONS = ("0001", "0002")  # the migrations in migrations/versions
HEAD = REVISIONS[-1]
LOCK_WAIT_S = 30
_MIGRATIONS_LOCK = 7_400_001  # advisory lock numbers of ours in PostgreSQL
_SQLITE_IS_BROKEN = re.compile(
    r"malformed|not a database|no such (table|column)|unsupported file format|corrupt|text encoding|decode",
    re.IGNORECASE,
)
# https://www.sqlite.org/rescode.html: PERM, READONLY, IOERR, FULL, CANTOPEN
_SQLITE_CANNOT_WRITE = (3, 8, 10, 13, 14)

METADATA = MetaData()
VERSIONS = Table(
    "map_version",
    METADATA,
    Column("map_id", String(100), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("kind", String(20), nullable=False),
    Column("name", String(400), nullable=False),
    Column("places", Integer, nullable=False),
    Column("navigation", Text, nullable=False),  # the navigation or navigations it was made from
    Column("created_ms", BigInteger, nullable=False),
    Column("record", String(80), nullable=False),  # its address
    Column("seal", String(64), nullable=False),  # of the columns above
    Column("author", String(200), nullable=False, server_default=""),  # the station that wrote it
)
# PostgreSQL: tables and views that an extension brings along, such as pg_stat_statements or PostGIS.
_OF_EXTENSIONS = (
    "SELECT relname FROM pg_class JOIN pg_depend ON pg_class.oid = objid"
    " WHERE deptype = 'e' AND classid = 'pg_class'::regclass"
)
_OURS = {"map_id", "number", "seal"}  # the columns of VERSIONS by which it is known


class IndexDamaged(DataError):
    """The database file is not what was written."""


class Database:
    """Connections to the index. A writer holds what it names, such as one map; everything in SQLite."""

    def __init__(self, url: str, folder: Path, place: str = "") -> None:
        """`place` is what messages call it; else its path, or its URL without the password."""
        self._url = _url(url, folder)
        self._folder = folder
        self.is_sqlite = self._url.get_backend_name() == "sqlite"
        self.path = Path(self._url.database or "") if self.is_sqlite else None
        self.place = place or str(self.path or self._url.render_as_string(hide_password=True))
        self._engine = _engine(self._url)
        self._is_named = bool(url)  # by the settings: the file may be another program's

    @property
    def exists(self) -> bool:
        return self.path is None or (self.path.is_file() and self.path.stat().st_size > 0)

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that writes nothing itself.

        Raises Unwritable: SQLite must first undo a transaction that was cut, and the disk takes no writes.
        """
        with self._in_words(), self._engine.connect() as connection, connection.begin():
            if self.is_sqlite:  # its BEGIN looks at nothing yet: whatever is wrong shows here, before the caller's work
                self._refuse_views_and_triggers(connection)
            yield connection

    @contextlib.contextmanager
    def writing(self, name: str) -> Iterator[Connection]:
        """One transaction, alone under this name; committed when the block ends, undone when it raises."""
        with self._in_words(), self._not_rebuilt(), self._engine.connect() as plain:
            connection = plain.execution_options(writes=True)
            with connection.begin():
                if self.is_sqlite:
                    self._refuse_views_and_triggers(connection)
                    _stamp(connection)
                else:
                    connection.execute(
                        text("SELECT pg_advisory_xact_lock(:kind, hashtext(:name))"),
                        {"kind": _MIGRATIONS_LOCK, "name": name},
                    )
                yield connection

    def revision(self, connection: Connection) -> str | None:
        """The migration the database is at; None for an empty one."""
        if not inspect(connection).has_table("alembic_version"):
            return None
        return connection.execute(text("SELECT version_num FROM alembic_version")).scalar()

    def migrate(self) -> bool:
        """Bring the tables to what this program uses; True when they were made just now.

        Raises:
            DataError: a newer program wrote them.
        """
        if self.path is not None:
            with self._in_words():
                self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.reading() as connection:
            revision = self.revision(connection)
        if revision == HEAD:
            return False
        if revision is not None and revision not in REVISIONS:
            self._refuse(revision)
        with self.writing("migrations") as connection:
            was_empty = self.revision(connection) is None
            upgrade(connection)
        return was_empty

    def refuse_foreign(self) -> None:
        """Raises DataError: the database is another program's, and stays as it is.

        In the store's own folder what cannot be read is ours, and is made anew; elsewhere, also behind a link, it may
        be anybody's.
        """
        if self.path is None:
            self._refuse_foreign_tables()
            return
        self._refuse_pipes()
        if not self.exists:
            return
        is_own = not self._is_named and not self.path.is_symlink()
        with self._in_words():
            why = why_foreign(self.path, VERSIONS.name, _OURS, in_own_place=is_own)
        if not why:
            return
        remedy = "name another file in store.database, or move this one away where it was one: the records make it anew"
        raise DataError(f"{self.place} {why}; {remedy}")

    def _refuse_pipes(self) -> None:
        """SQLite would wait for ever for the other end of one, also in the place of its journal."""
        assert self.path is not None
        for suffix in ("", "-journal", "-wal", "-shm"):
            path = self.path.with_name(self.path.name + suffix)
            if path.exists() and not path.is_file() and not path.is_dir():
                raise DataError(f"{path} is no regular file, as SQLite needs; move it away")

    def _refuse_foreign_tables(self) -> None:
        """PostgreSQL: in the schema that ours would be put into. Who was put beside ours later does not matter."""
        with self.reading() as connection:
            found = inspect(connection)
            of_extensions = set(connection.execute(text(_OF_EXTENSIONS)).scalars())
            names = sorted({*found.get_table_names(), *found.get_view_names()} - of_extensions)
            columns = found.get_columns(VERSIONS.name) if VERSIONS.name in names else []
        if not names or {column["name"] for column in columns} >= _OURS:
            return
        raise DataError(
            f"{self.place} is another program's database (it has {shown(names[0])}); name another one in"
            " store.database, empty, such as `createdb` makes"
        )

    def _refuse_views_and_triggers(self, connection: Connection) -> None:
        """A view in a table's place, or a trigger: in a file from elsewhere either could compute without end."""
        kinds = "SELECT group_concat(DISTINCT type) FROM sqlite_master WHERE type IN ('view', 'trigger')"
        if (found := connection.exec_driver_sql(kinds).scalar()) is not None:
            raise IndexDamaged(f"{self.place} is damaged (it has a {found}, as no station makes)")

    def _refuse(self, revision: str) -> None:
        """A revision this program does not know: of a newer one, whose tables differ, or a wrong bit."""
        with self.reading() as connection:
            if not inspect(connection).has_table(VERSIONS.name):
                raise IndexDamaged(f"{self.place} is damaged (it has no table {VERSIONS.name!r})")
            columns = {column["name"] for column in inspect(connection).get_columns(VERSIONS.name)}
        if columns == set(VERSIONS.c.keys()):
            raise IndexDamaged(f"{self.place} is damaged (it says it is at migration {revision!r})")
        raise DataError(
            f"{self.place} was written by a newer station (migration {revision}, this one knows {HEAD}); update this"
            " station"
        )

    def check(self) -> None:
        """SQLite: compare pages and indices. Raises IndexDamaged, in words. Nothing to do in PostgreSQL."""
        if not self.is_sqlite:
            return
        with self.reading() as connection:
            answers = connection.execute(text("PRAGMA integrity_check(3)")).scalars().all()
        if answers != ["ok"]:
            raise IndexDamaged(f"{self.place} is damaged ({'; '.join(answers)})")

    def set_aside(self) -> Path:
        """Give a broken SQLite file another name, so that a new one can be made; the new name."""
        assert self.path is not None
        with self._in_words(), _locked(self._folder, shared=False):
            aside = self.path.with_name(
                f"{self.path.name}.damaged-{time.strftime('%Y%m%d-%H%M%S')}-{time.time_ns() % 10**9:09d}"
            )
            try:
                os.replace(self.path, aside)
                self.path.with_name(f"{self.path.name}-journal").unlink(missing_ok=True)
            except OSError as exc:
                raise Unwritable(f"{self.path} is damaged and cannot be set aside ({exc.strerror})") from exc
        return aside

    @contextlib.contextmanager
    def held_still(self) -> Iterator[None]:
        """Nobody writes meanwhile. Needs no write itself; raises DataError for a writer that does not end."""
        with self._in_words(), contextlib.ExitStack() as stack:
            with contextlib.suppress(FileNotFoundError, PermissionError):  # nobody has ever written, or it is hidden
                if not lock(stack.enter_context(open_file(self._folder / LOCK)), timeout_s=LOCK_WAIT_S):
                    raise DataError(f"{self.place} cannot be used (another program writes); end that, or wait")
            yield

    def close(self) -> None:
        self._engine.dispose()

    @contextlib.contextmanager
    def _not_rebuilt(self) -> Iterator[None]:
        """While this is held nobody sets the file aside that is being written."""
        if not self.is_sqlite:
            yield
            return
        with _locked(self._folder, shared=True):
            yield

    @contextlib.contextmanager
    def _in_words(self) -> Iterator[None]:
        try:
            yield
        except DBAPIError as exc:
            reason = str(exc.orig).strip().splitlines()[0] if str(exc.orig).strip() else type(exc.orig).__name__
            if self.is_sqlite and _SQLITE_IS_BROKEN.search(reason):
                raise IndexDamaged(f"{self.place} is damaged ({reason})") from exc
            if self.is_sqlite and getattr(exc.orig, "sqlite_errorcode", 0) & 0xFF in _SQLITE_CANNOT_WRITE:
                told = None if self.path is None else why_unwritable(self.path.parent)
                if told is not None:  # says it better than "unable to open database file"
                    raise cannot_write(self.place, told) from exc
                raise Unwritable(f"{self.place} cannot be used ({reason}); {self._remedy(reason)}") from exc
            if isinstance(exc, NotStorable):  # PostgreSQL holds no NUL, SQLite does: nothing is damaged
                raise DataError(f"{self.place} cannot hold what was given ({reason})") from exc
            if isinstance(exc, OperationalError):
                raise DataError(f"{self.place} cannot be used ({reason}); {self._remedy(reason)}") from exc
            raise IndexDamaged(f"{self.place} is damaged ({reason})") from exc
        except UnicodeDecodeError as exc:  # sqlite3 quotes the damaged text in its own error, and cannot
            raise IndexDamaged(f"{self.place} is damaged (it holds text that is none)") from exc
        except OSError as exc:
            raise cannot_write(self.place, exc) from exc

    def _remedy(self, reason: str) -> str:
        if not self.is_sqlite:
            return "check that PostgreSQL runs there and takes this user"
        if "locked" in reason:
            return "another program holds it; end that, or wait"
        if "full" in reason:
            return "free space, or choose another folder"
        return "make its disk writable again, or choose a folder that can be written"


def _stamp(connection: Connection) -> None:
    """Say in an SQLite file's header whose it is, also in one that was made before there were stamps."""
    number = int.from_bytes(STAMP)
    if connection.exec_driver_sql("PRAGMA application_id").scalar() != number:
        connection.exec_driver_sql(f"PRAGMA application_id = {number}")


def upgrade(connection: Connection, revision: str = HEAD) -> None:
    """Run the migrations up to a revision, in this connection's transaction."""
    from alembic.command import upgrade as run  # half a second to load, and seldom needed
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.attributes["connection"] = connection
    run(config, revision)


def _url(url: str, folder: Path) -> URL:
    if not url:
        return URL.create("sqlite+pysqlite", database=str((folder / "maps.db").absolute()))
    try:
        made = make_url(url)
    except (ArgumentError, ValueError) as exc:  # ValueError: a port that is none
        raise ConfigError("store.database is no database URL; give postgresql://user@host/name") from exc
    if made.drivername in ("postgresql", "postgres"):
        made = made.set(drivername="postgresql+psycopg")
    if "uri" in made.query or (made.database or "").startswith("file:"):
        raise ConfigError("store.database: give SQLite's file by its path, as in sqlite:////var/lib/sentinel/maps.db")
    if made.get_backend_name() not in ("sqlite", "postgresql"):
        raise ConfigError(f"store.database: {made.get_backend_name()} is not supported; use postgresql or sqlite")
    return made


def _engine(url: URL) -> Engine:
    if url.get_backend_name() != "sqlite":
        try:
            return create_engine(url, poolclass=NullPool, connect_args={"connect_timeout": 10})
        except (NoSuchModuleError, ImportError) as exc:
            raise ConfigError(f"store.database: PostgreSQL needs psycopg; run: {install('fleet')}") from exc
    # A connection per transaction: no process keeps a file open that another one may set aside.
    engine = create_engine(url, poolclass=NullPool, connect_args={"timeout": LOCK_WAIT_S})

    @event.listens_for(engine, "connect")
    def _on_connect(connection: Any, _: object) -> None:
        connection.isolation_level = None  # the driver's own way of beginning would leave DDL outside transactions
        connection.execute("PRAGMA synchronous=EXTRA")  # also the journal's removal survives a power cut

    @event.listens_for(engine, "begin")
    def _on_begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get("writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


@contextlib.contextmanager
def _locked(folder: Path, *, shared: bool) -> Iterator[None]:
    """A lock between processes of this machine."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    path.touch()
    with open_file(path, for_writing=True) as file:
        lock(file, shared=shared)
        yield
