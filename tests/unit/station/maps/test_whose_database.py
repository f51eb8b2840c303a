"""Whose a database is that stands where ours should: ours is used and put right, another program's stays as it is."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sqlite3
from pathlib import Path

import pytest
from typer.testing import CliRunner

from shared.errors import DataError
from station.main import app
from station.maps.store import MapStore
from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from tests.support.postgres import PostgresServer
from tests.support.store import rename_place


def stamp_of(path: Path) -> bytes:
    return path.read_bytes()[68:72]


def test_a_newer_database_is_refused(place_map: PlaceMap, tmp_path: Path) -> None:
    MapStore(tmp_path).save(place_map)
    with sqlite3.connect(tmp_path / "maps.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9000'")
        connection.execute("ALTER TABLE map_version ADD COLUMN mood TEXT")
    connection.close()
    with pytest.raises(DataError, match="newer station"):
        MapStore(tmp_path).list()


@pytest.mark.parametrize(
    ("tables", "cut", "said"),
    [
        ("", None, "no SQLite database"),
        ("CREATE TABLE song (title TEXT)", None, "another program's database .*'song'"),
        ("CREATE TABLE alembic_version (version_num TEXT); INSERT INTO alembic_version VALUES ('9')", None, "'alembic"),
        ("CREATE TABLE song (title TEXT)", 500, "may be another program's"),
        ("CREATE VIEW song AS SELECT 1", None, "another program's database .*'song'"),
        ("CREATE TABLE map_version (a, b)", None, "another program's database .*'map_version'"),
        ("PRAGMA application_id = 1234567", None, "another program's database"),
        ("PRAGMA user_version = 7", None, "another program's database"),
    ],
)
@pytest.mark.parametrize("has_maps", [False, True])
def test_the_file_of_another_program_is_refused_and_stays_as_it_was(
    place_map: PlaceMap, tmp_path: Path, tables: str, cut: int | None, said: str, has_maps: bool
) -> None:
    if has_maps:
        MapStore(tmp_path / "maps").save(place_map)
    theirs = tmp_path / "theirs"
    if tables:
        with contextlib.closing(sqlite3.connect(theirs)) as connection:
            connection.executescript(tables)
        theirs.write_bytes(theirs.read_bytes()[:cut])
    else:
        theirs.write_text("root:x:0:0:root:/root:/bin/sh\n")
    before = theirs.read_bytes()
    store = MapStore(StoreAddress(tmp_path / "maps", f"sqlite:///{theirs}"))
    for use in (store.list, lambda: store.save(place_map)):
        with pytest.raises(DataError, match=said):
            use()
    assert [path.name for path in tmp_path.iterdir() if path.name != "maps"] == ["theirs"]
    assert theirs.read_bytes() == before


@pytest.mark.parametrize("mode", ["WAL", "DELETE"])
def test_a_database_that_another_program_left_unfinished_is_not_touched(
    place_map: PlaceMap, tmp_path: Path, mode: str
) -> None:
    """By a kill: what its log or journal says is for that program to put right."""
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    with contextlib.closing(sqlite3.connect(theirs / "songs", isolation_level=None)) as connection:
        connection.execute(f"PRAGMA journal_mode={mode}")
        connection.execute("PRAGMA cache_size=1")
        connection.execute("CREATE TABLE song (title TEXT)")
        connection.execute("BEGIN")
        for _ in range(200):
            connection.execute("INSERT INTO song VALUES (hex(randomblob(500)))")
        shutil.copytree(theirs, tmp_path / "left")
        connection.execute("ROLLBACK")
    left = tmp_path / "left"
    before = {path.name: path.read_bytes() for path in left.iterdir()}
    assert len(before) > 1
    with pytest.raises(DataError, match="another program's database"):
        MapStore(StoreAddress(tmp_path / "maps", f"sqlite:///{left / 'songs'}")).save(place_map)
    assert {path.name: path.read_bytes() for path in left.iterdir()} == before


@pytest.mark.parametrize(
    "tables",
    [
        "CREATE TABLE song (title TEXT)",
        "CREATE TABLE song (title TEXT); PRAGMA application_id = 1234567",
        "CREATE TABLE map_version (a, b)",
        "CREATE TABLE alembic_version (version_num TEXT); INSERT INTO alembic_version VALUES ('9')",
    ],
)
@pytest.mark.parametrize("is_link", [False, True])
def test_another_programs_database_in_the_stores_own_folder_is_refused_too(
    tmp_path: Path, tables: str, is_link: bool
) -> None:
    """A folder of data that somebody else gave may hold one, or a link to one of this machine."""
    own = tmp_path / "maps" / "maps.db"
    own.parent.mkdir()
    theirs = tmp_path / "theirs" if is_link else own
    with contextlib.closing(sqlite3.connect(theirs)) as connection:
        connection.executescript(tables)
    if is_link:
        own.symlink_to(theirs)
    before = theirs.read_bytes()
    with pytest.raises(DataError, match="is another program's database"):
        MapStore(tmp_path / "maps").list()
    assert theirs.read_bytes() == before


def test_behind_a_link_in_the_stores_folder_nothing_is_set_aside(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.write_text("root:x:0:0:root:/root:/bin/sh\n")
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "maps.db").symlink_to(theirs)
    with pytest.raises(DataError, match="no SQLite database"):
        MapStore(tmp_path / "maps").list()
    assert theirs.read_text().startswith("root:") and (tmp_path / "maps" / "maps.db").is_symlink()


@pytest.mark.parametrize("name", ["maps.db", "maps.db-journal", "maps.db-wal", "maps.db-shm", ".lock"])
def test_a_pipe_in_the_stores_folder_is_not_waited_for(place_map: PlaceMap, tmp_path: Path, name: str) -> None:
    MapStore(tmp_path).save(place_map)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(DataError, match=f"{re.escape(str(tmp_path))}.*(regular file|pipe)"):
        MapStore(tmp_path).save(place_map)


@pytest.mark.parametrize(
    ("statement", "found"),
    [
        ("CREATE TABLE song (title TEXT)", "'song'"),
        ("CREATE VIEW song AS SELECT 1 AS title", "'song'"),
        ("CREATE TABLE map_version (a INTEGER)", "'map_version'"),
        ("CREATE TABLE alembic_version (version_num TEXT)", "'alembic_version'"),
    ],
)
def test_a_postgresql_database_of_another_program_is_refused_and_stays_as_it_was(
    place_map: PlaceMap, tmp_path: Path, postgres: PostgresServer, statement: str, found: str
) -> None:
    import psycopg

    url = postgres.fresh_database()
    with psycopg.connect(url) as connection:
        connection.execute(statement)
        if "alembic" in statement:
            connection.execute("INSERT INTO alembic_version VALUES ('0002')")  # a number of ours, by chance
    store = MapStore(StoreAddress(tmp_path / "maps", url))
    for use in (store.list, lambda: store.save(place_map)):
        with pytest.raises(DataError, match=f"another program's database .*{found}"):
            use()
    with psycopg.connect(url) as connection:
        names = connection.execute("SELECT relname FROM pg_class WHERE relnamespace = 'public'::regnamespace")
        assert [f"'{name}'" for (name,) in names] == [found]


def test_what_an_extension_of_postgresql_brings_along_is_no_other_programs(
    place_map: PlaceMap, tmp_path: Path, postgres: PostgresServer
) -> None:
    import psycopg

    url = postgres.fresh_database()
    with psycopg.connect(url) as connection:
        connection.execute("CREATE EXTENSION pg_stat_statements")
    MapStore(StoreAddress(tmp_path / "maps", url)).save(place_map)


def test_a_postgresql_database_that_is_ours_already_is_used_whatever_was_put_beside_it(
    place_map: PlaceMap, tmp_path: Path, postgres: PostgresServer
) -> None:
    import psycopg

    address = StoreAddress(tmp_path / "maps", postgres.fresh_database())
    MapStore(address).save(place_map)
    with psycopg.connect(address.database) as connection:
        connection.execute("CREATE TABLE song (title TEXT)")
    assert [one.id for one in MapStore(address).list()] == [place_map.id]


@pytest.mark.parametrize("at", [3, 68, 69, 70, 71, 100])
def test_one_wrong_bit_makes_ours_no_other_programs(place_map: PlaceMap, tmp_path: Path, at: int) -> None:
    address = StoreAddress(tmp_path / "maps", f"sqlite:///{tmp_path / 'ours.db'}")
    MapStore(address).save(place_map)
    content = bytearray((tmp_path / "ours.db").read_bytes())
    content[at] ^= 1
    (tmp_path / "ours.db").write_bytes(content)
    assert [one.id for one in MapStore(address).list()] == [place_map.id]


def test_a_database_from_before_stamps_gets_one_when_it_is_written_and_not_before(
    place_map: PlaceMap, tmp_path: Path
) -> None:
    ours = tmp_path / "ours.db"
    address = StoreAddress(tmp_path / "maps", f"sqlite:///{ours}")
    MapStore(address).save(place_map)
    assert stamp_of(ours) == b"SntM"
    with contextlib.closing(sqlite3.connect(ours)) as connection:
        connection.execute("PRAGMA application_id = 0")
    before = ours.read_bytes()
    assert [one.id for one in MapStore(address).list()] == [place_map.id]
    assert ours.read_bytes() == before
    rename_place(MapStore(address), place_map.id, place_map.places[0].id, "Sofa")
    assert stamp_of(ours) == b"SntM"


@pytest.mark.parametrize(
    ("name", "sql"), [("x'ff'", "x'435245ff'"), ("'\x1b[31msong'", "'CREATE TABLE \x1b]0;owned ((('"), ("x'ff'", "sql")]
)
def test_a_named_database_whose_schema_is_no_text_is_refused_in_a_sentence(
    place_map: PlaceMap, tmp_path: Path, name: str, sql: str
) -> None:
    theirs = tmp_path / "theirs"
    with contextlib.closing(sqlite3.connect(theirs)) as connection:
        connection.execute("CREATE TABLE song (title TEXT)")
        connection.execute("PRAGMA writable_schema = 1")
        connection.execute(f"UPDATE sqlite_master SET name = CAST({name} AS TEXT), sql = CAST({sql} AS TEXT)")
        connection.commit()
    before = theirs.read_bytes()
    config = tmp_path / "station.toml"
    config.write_text(f'[store]\ndatabase = "sqlite:///{theirs}"\n')
    result = CliRunner().invoke(app, ["map", "list", "--data", str(tmp_path / "data"), "--config", str(config)])
    assert isinstance(result.exception, DataError), result.exception
    assert "another program's" in str(result.exception) and "\x1b" not in str(result.exception)
    assert theirs.read_bytes() == before


def test_a_database_that_the_settings_name_is_used_again(place_map: PlaceMap, tmp_path: Path) -> None:
    address = StoreAddress(tmp_path / "maps", f"sqlite:///{tmp_path / 'ours.db'}")
    MapStore(address).save(place_map)
    assert [one.id for one in MapStore(address).list()] == [place_map.id]


def test_an_index_that_says_migrations_and_has_no_table_is_made_anew(place_map: PlaceMap, tmp_path: Path) -> None:
    MapStore(tmp_path).save(place_map)
    with contextlib.closing(sqlite3.connect(tmp_path / "maps.db")) as connection:
        connection.executescript("UPDATE alembic_version SET version_num = '9'; DROP TABLE map_version")
    assert [one.id for one in MapStore(tmp_path).list()] == [place_map.id]
