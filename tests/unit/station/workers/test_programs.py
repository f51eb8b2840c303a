"""Each worker's program is where its name says, and answers everything it can be asked."""

from __future__ import annotations

from typing import Any

import pytest

from station.workers.library_requests import LIBRARY, LibraryProgram
from station.workers.place_requests import PLACES, PlaceProgram
from station.workers.request import Program, ProgramName
from station.workers.slam_requests import SLAM, SlamProgram


@pytest.mark.parametrize(
    ("name", "interface"), [(SLAM, SlamProgram), (PLACES, PlaceProgram), (LIBRARY, LibraryProgram)]
)
def test_a_program_is_found_by_its_name_and_answers_all_that_its_interface_asks(
    name: ProgramName[Any, Any], interface: type[Program]
) -> None:
    events: list[object] = []
    assert isinstance(name.load()(events.append), interface)  # one that leaves out an answer cannot be made


def test_a_program_that_leaves_out_an_answer_cannot_be_made() -> None:
    mute = type("Mute", (SlamProgram,), {})
    with pytest.raises(TypeError, match="abstract"):
        mute()
