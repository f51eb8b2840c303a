"""What a person who drives before a target is told next: which move is missing, and when the robot has rested."""

from __future__ import annotations

from itertools import pairwise

from shared.calibration import CameraCalibration
from station.calibration.guidance import MIN_CORNERS, Guidance
from station.calibration.target import BoardView
from station.calibration.wheels import LEAST_VIEWS, Commands, find_rests, is_drive, is_turn
from station.model.frames import DriveSample
from station.motion.drive_commands import commands_motion

# Of each. Six ways and six turns are accepted where single ones differ by up to 2.7 % (MAX_SIGMA, Student's quantile),
# as those of cheap motors do, or of a robot whose computer is busy; four only up to 1.3 %.
WANTED = 3
FORTH, BACK, LEFT, RIGHT = "forth", "back", "left", "right"
WISHES = {
    FORTH: "drive straight on for some 40 cm, then let go",
    BACK: "drive straight back for some 40 cm, then let go",
    LEFT: "turn on the spot to the left for two seconds, then let go",
    RIGHT: "turn on the spot to the right for two seconds, then let go",
}


class WheelsGuide:
    """Follows how the robot was driven, from its commands, and where the target was seen meanwhile."""

    def __init__(self, camera: CameraCalibration) -> None:
        self._shift_ns = round(camera.middle_row_shift_s * 1e9)
        self._drive: list[DriveSample] = []
        self.views: list[BoardView] = []  # those that show enough of the target

    def drive(self, samples: list[DriveSample]) -> None:
        """What the motors were told since the last call."""
        self._drive += samples

    def look(self, view: BoardView | None) -> Guidance:
        """Take in what a picture shows of the target; None: nothing."""
        is_seen = view is not None and len(view.ids) >= MIN_CORNERS and view.ids_are_sure
        if view is not None and is_seen:
            self.views.append(view)
        if not self._drive:
            return self._guidance("wait until the robot tells what it drives", {}, is_seen)
        end_ns = self._drive[-1].t_robot_ns + 1
        rests = find_rests(self._drive, end_ns)
        moves = self._moves(rests)
        if commands_motion(self._drive[-1]):
            return self._guidance("let go after some 40 cm, or after two seconds of turning", moves, is_seen)
        if not rests or rests[-1][1] < end_ns:
            return self._guidance("wait until it stands still", moves, is_seen)
        wish = next((name for name in WISHES if moves[name] < self._wanted_now(moves)), None)
        if wish is None:
            return self._guidance("enough: finish, or go on for still smaller errors", moves, is_seen)
        if wish in (FORTH, BACK) and self._seen_in(rests[-1]) < LEAST_VIEWS:
            hint = "the camera looks at the board: wait" if is_seen else "turn the robot so that it sees the board"
            return self._guidance(hint, moves, is_seen)
        return self._guidance(WISHES[wish], moves, is_seen)

    def _wanted_now(self, moves: dict[str, int]) -> int:
        """To and fro, then to and fro again: one more than there is of the least, at most what is wanted."""
        ways = (FORTH, BACK) if min(moves[FORTH], moves[BACK]) < WANTED else (LEFT, RIGHT)
        return min(WANTED, min(moves[way] for way in ways) + 1)

    def _moves(self, rests: list[tuple[int, int]]) -> dict[str, int]:
        """How many there are of each; a way counts where the target was seen before and after it."""
        counts, told = dict.fromkeys(WISHES, 0), Commands(self._drive)
        for before, after in pairwise(rests):
            (way_m, turn_rad), (largest_m_s, largest_rad_s) = told.between(before[1], after[0])
            if is_drive(float(way_m), float(largest_rad_s)):
                if min(self._seen_in(before), self._seen_in(after)) >= LEAST_VIEWS:
                    counts[FORTH if way_m > 0 else BACK] += 1
            elif is_turn(float(turn_rad), float(largest_m_s)):
                counts[LEFT if turn_rad > 0 else RIGHT] += 1
        return counts

    def _seen_in(self, rest: tuple[int, int]) -> int:
        """How many pictures of a rest show the target."""
        return sum(rest[0] < view.t_robot_ns + self._shift_ns <= rest[1] for view in self.views)

    def _guidance(self, instruction: str, moves: dict[str, int], is_seen: bool) -> Guidance:
        shares = {name: min(1.0, moves.get(name, 0) / WANTED) for name in WISHES}
        is_enough = all(share >= 1.0 for share in shares.values())
        return Guidance(instruction, is_seen, sum(moves.values()), (), shares, is_enough, is_enough)
