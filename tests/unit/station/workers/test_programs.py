"""Each worker's program is where its name says, and answers everything it can be asked."""

from __future__ import annotations

import pickle
from typing import Any

import pytest

from station.model.frames import DriveSample
from station.workers.library_requests import LIBRARY, LibraryProgram
from station.workers.place_requests import PLACES, AddImu, AddPose, PlaceProgram
from station.workers.request import MAX_WAITING, Limit, Program, ProgramName, Request
from station.workers.slam_requests import SLAM, AddDrive, FinishNavigation, SlamProgram


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


def test_a_request_travels_and_runs_in_the_program() -> None:
    asked: list[DriveSample] = []

    class Listening(Program):
        def add_drive(self, sample: DriveSample) -> None:
            asked.append(sample)

    request: Request[Any, None] = pickle.loads(pickle.dumps(AddDrive(DriveSample(1, 0.5, 0.25))))
    request.run(Listening())
    assert asked == [DriveSample(1, 0.5, 0.25)]


def test_limits_stand_at_the_requests() -> None:
    assert AddDrive.limit == Limit(6000)
    assert (AddPose.limit, AddImu.limit) == (Limit(300), Limit(30_000))
    assert FinishNavigation.limit == Limit(MAX_WAITING)
