"""Maps come back as they were saved; damage becomes a sentence, never a traceback or half a map."""

from pathlib import Path

import numpy as np
import pytest

from shared.errors import DataError
from station.maps import store as store_module
from station.maps.map import PlaceMap
from station.maps.store import MapStore
from station.places.build import build_map
from tests.synthetic_home import drive, furnished_room, navigate


@pytest.fixture(scope="module")
def place_map() -> PlaceMap:
    home = furnished_room(1)
    return build_map(navigate(home, drive(home, 1, frames=40, turns=1.0), seed=1))


def test_a_map_comes_back_as_it_was_saved(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path / "maps")
    store.save(place_map)
    again = store.load(place_map.id)
    assert (again.id, again.name, again.edges, again.config) == (
        place_map.id, place_map.name, place_map.edges, place_map.config
    )  # fmt: skip
    assert again.navigation.id == place_map.navigation.id
    for a, b in zip(again.places, place_map.places, strict=True):
        assert (a.id, a.name, a.radius, a.quality, a.representative_keyframe) == (
            b.id, b.name, b.radius, b.quality, b.representative_keyframe
        )  # fmt: skip
        np.testing.assert_array_equal(a.centroid_map, b.centroid_map)
        np.testing.assert_array_equal(a.landmark_index, b.landmark_index)
        np.testing.assert_array_equal(a.keyframe_index, b.keyframe_index)
    np.testing.assert_array_equal(again.navigation.landmarks.p_world, place_map.navigation.landmarks.p_world)
    assert again.navigation.keyframes.encoded == place_map.navigation.keyframes.encoded


def test_a_new_name_is_kept_and_names_stay_unique(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)
    first, second = place_map.places[:2]
    store.rename_place(place_map.id, first.id, "  Sofa   corner ")
    assert store.load(place_map.id).places[0].name == "Sofa corner"
    with pytest.raises(DataError, match='another place named "sofa corner"'):
        store.rename_place(place_map.id, second.id, "sofa corner")
    with pytest.raises(DataError, match="1 to 80 characters"):
        store.rename_place(place_map.id, second.id, " ")
    with pytest.raises(DataError, match='no place with id "x"'):
        store.rename_place(place_map.id, "x", "Desk")


def test_saving_again_replaces_and_deleting_forgets(place_map: PlaceMap, tmp_path: Path) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)
    store.save(place_map)
    assert [(s.id, s.places) for s in store.list()] == [(place_map.id, len(place_map.places))]
    assert len(list(tmp_path.iterdir())) == 1
    store.delete(place_map.id)
    assert store.list() == () and list(tmp_path.iterdir()) == []
    with pytest.raises(DataError, match="its maps: none"):
        store.load(place_map.id)


@pytest.mark.parametrize("pattern", ["map.json", "navigation/landmarks.ply", "navigation/keyframes/*"])
@pytest.mark.parametrize("damage", ["flip", "cut", "remove"])
def test_damage_is_named(place_map: PlaceMap, tmp_path: Path, pattern: str, damage: str) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)
    path = next((tmp_path / f"{place_map.id}.000001").glob(pattern))
    data = bytearray(path.read_bytes())
    if damage == "remove":
        path.unlink()
    else:
        data[len(data) // 2] ^= 1
        path.write_bytes(data[: len(data) // 3] if damage == "cut" else data)
    with pytest.raises(DataError, match=r"damaged|missing|no map\.json"):
        store.load(place_map.id)
    assert len(store.list()) == 1


def test_an_interrupted_save_leaves_the_old_map(
    place_map: PlaceMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = MapStore(tmp_path)
    store.save(place_map)

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store_module, "_write_content", fail)
    with pytest.raises(DataError, match="No space left"):
        store.save(place_map)
    assert store.load(place_map.id).places
    assert [path.name for path in tmp_path.iterdir()] == [f"{place_map.id}.000001"]


def test_an_id_cannot_leave_the_folder(place_map: PlaceMap, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no map"):
        MapStore(tmp_path).load("../../etc")
