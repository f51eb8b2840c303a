"""What a person who drives before a board is told next."""

from __future__ import annotations

import numpy as np
import pytest

from shared.calibration import REFERENCE_CAMERA
from station.calibration.guidance import Guidance
from station.calibration.target import BoardView
from station.calibration.wheels import GYRO_SIGMA, MAX_SIGMA, fit_factor
from station.calibration.wheels_guide import BACK, FORTH, LEFT, RIGHT, WANTED, WISHES, WheelsGuide
from station.model.frames import DriveSample

STEP_NS = 50_000_000
MOVES = {FORTH: (0.2, 0.0), BACK: (-0.2, 0.0), LEFT: (0.0, 0.8), RIGHT: (0.0, -0.8)}


class Driver:
    """Drives and shows the board, as told or not."""

    def __init__(self) -> None:
        self.guide = WheelsGuide(REFERENCE_CAMERA)
        self.t_ns = 1_000_000_000

    def go_on(self, seconds: float, linear: float, angular: float, sees: bool) -> Guidance:
        said: Guidance | None = None
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.t_ns += STEP_NS
            self.guide.drive([DriveSample(self.t_ns, linear, angular)])
            said = self.guide.look(self._view() if sees else None)
        assert said is not None
        return said

    def move(self, name: str, sees: bool = True) -> Guidance:
        self.go_on(2.0, *MOVES[name], sees=False)
        return self.go_on(2.0, 0.0, 0.0, sees)

    def _view(self) -> BoardView:
        return BoardView(f"{self.t_ns}.jpg", self.t_ns, np.arange(144), np.zeros((144, 2)))


def test_who_does_what_is_said_has_enough_after_twelve_moves() -> None:
    driver = Driver()
    said = driver.go_on(2.0, 0.0, 0.0, sees=True)
    for number in range(12):
        assert not said.may_finish
        name = next(name for name, words in WISHES.items() if words == said.instruction)
        said = driver.move(name)
        assert said.num_views == number + 1
    assert said.is_enough and said.may_finish and said.instruction.startswith("enough")


@pytest.mark.parametrize(("name", "count"), [(FORTH, 0), (BACK, 0), (LEFT, 1), (RIGHT, 1)])
def test_a_way_counts_only_where_the_board_was_seen_before_and_after_it(name: str, count: int) -> None:
    driver = Driver()
    driver.go_on(2.0, 0.0, 0.0, sees=True)
    said = driver.move(name, sees=False)
    assert said.num_views == count  # the gyroscope judges a turn
    assert "sees the board" in said.instruction


def test_an_arc_counts_for_nothing() -> None:
    driver = Driver()
    driver.go_on(2.0, 0.0, 0.0, sees=True)
    driver.go_on(2.0, 0.2, 0.8, sees=True)
    assert driver.go_on(2.0, 0.0, 0.0, sees=True).num_views == 0


def test_whoever_drives_is_told_to_let_go_and_to_wait() -> None:
    driver = Driver()
    driver.go_on(2.0, 0.0, 0.0, sees=True)
    assert "let go" in driver.go_on(0.5, 0.2, 0.0, sees=True).instruction
    assert "stands still" in driver.go_on(0.3, 0.0, 0.0, sees=True).instruction


def test_as_many_moves_as_are_wanted_bear_a_scatter_of_a_fortieth() -> None:
    scatter, sort = 0.025, 2 * WANTED  # forth and back, or left and right
    spread = scatter * np.sqrt((sort - 1) / sort) * np.tile([1.0, -1.0], WANTED)
    factor = fit_factor([(1.0, float(0.4 * (1.0 + part))) for part in spread], GYRO_SIGMA)
    assert factor is not None
    assert factor.scatter == pytest.approx(scatter, rel=1e-6)
    assert factor.sigma / factor.value < MAX_SIGMA
