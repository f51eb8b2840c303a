"""Each worker's program is where its name says, and answers everything it can be asked."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

from station.workers.library_interface import LIBRARY, LibraryProgram
from station.workers.place_interface import PLACES, PlaceProgram
from station.workers.request import Program, ProgramName
from station.workers.slam_interface import SLAM, SlamProgram

each_program = pytest.mark.parametrize(
    ("name", "interface"), [(SLAM, SlamProgram), (PLACES, PlaceProgram), (LIBRARY, LibraryProgram)]
)


@each_program
def test_a_program_is_found_by_its_name_and_answers_all_that_its_interface_asks(
    name: ProgramName[Any, Any], interface: type[Program]
) -> None:
    events: list[object] = []
    assert isinstance(name.load()(events.append), interface)  # one that leaves out an answer cannot be made


@each_program
def test_a_program_takes_the_arguments_that_its_interface_names(
    name: ProgramName[Any, Any], interface: type[Program]
) -> None:
    events: list[object] = []
    program = name.load()(events.append)
    for method, asked_of in inspect.getmembers(interface, inspect.isfunction):
        if not getattr(asked_of, "__isabstractmethod__", False):
            continue
        _, *asked = inspect.signature(asked_of).parameters.values()  # without self
        taken = list(inspect.signature(getattr(program, method)).parameters.values())
        assert [(p.name, p.default) for p in taken[: len(asked)]] == [(p.name, p.default) for p in asked], method
        assert all(p.default is not p.empty for p in taken[len(asked) :]), method


def test_a_program_that_leaves_out_an_answer_cannot_be_made() -> None:
    mute = type("Mute", (SlamProgram,), {})
    with pytest.raises(TypeError, match="abstract"):
        mute()
