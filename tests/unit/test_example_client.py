"""What the example client says of an answer."""

from __future__ import annotations

import runpy
from typing import Any

import pytest

from tests.support.paths import ROOT

SENTENCE = runpy.run_path(str(ROOT / "examples" / "place_client.py"))["sentence"]
KITCHEN = {"id": "room-k", "name": "Kitchen", "probability": 0.98}


STOVE = {"id": "place-1", "name": "Stove"}


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"room": KITCHEN, "place": STOVE}, "in Kitchen (98%), at Stove (90%): why"),
        ({"room": KITCHEN, "place": STOVE, "place_elsewhere": True}, "in Kitchen (98%): why"),
        ({"room": KITCHEN, "place": None, "state": "lost"}, "in Kitchen (98%): why"),
        (
            {"room": None, "place": STOVE, "distance_m": 0.5},
            "at Stove (90%, 0.5 m from its middle): why",
        ),
        ({"room": None, "place": None, "state": "lost"}, "lost: why"),
    ],
)
def test_the_example_client_tells_the_room_and_a_place_of_it(told: dict[str, Any], words: str) -> None:
    answer = {"state": "known", "probability": 0.9, "place_elsewhere": False, "distance_m": None, "reason": "why"}
    assert SENTENCE(answer | told) == words
