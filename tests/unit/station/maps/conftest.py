"""A small map, and stores to keep it in: the whole suite runs on SQLite and on PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from station.model.map_store import StoreAddress
from station.model.place_map import PlaceMap
from station.places.making.build import build_map
from tests.support.postgres import PostgresServer, running_postgres
from tests.support.synthetic_home import drive, furnished_room, navigate


@pytest.fixture(scope="session")
def place_map() -> PlaceMap:
    home = furnished_room(1)
    navigation = navigate(home, drive(home, 1, frames=40, turns=1.0), seed=1)
    return build_map(replace(navigation, id="nav-1"))


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    with running_postgres() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> StoreAddress:
    """An empty store."""
    if request.param == "sqlite":
        return StoreAddress(tmp_path / "maps", author="desk")
    server: PostgresServer = request.getfixturevalue("postgres")
    return StoreAddress(tmp_path / "maps", server.fresh_database(), author="desk")
