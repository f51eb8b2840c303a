"""Runs the tracker over a recorded drive again, in seconds: what the localiser found is played back, not found anew.

The recorded attempts are the real localiser's, on the real map. Everything after them, the belief's model, the hijack
cues and the odometry, runs as it is now.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from shared.calibration import Calibration
from station.model.calibration_fit import CalibrationFit
from station.model.frames import DriveSample, ImageFrame, ImuBatch
from station.model.place_answer import HijackEvent, PlaceAnswer
from station.model.place_map import PlaceMap
from station.places.localisation.localizer import Attempt, Localizer
from station.places.localisation.tried_pictures import TriedPicture
from station.places.tracking.tracker import PlaceTracker
from tests.support.drives.recorded import LookedAt, RecordedDrive, SlamFit, SlamPose

MakeTracker = Callable[[Sequence[PlaceMap], Calibration, Localizer], PlaceTracker]


class PlayedBackLocalizer(Localizer):
    """Gives the recorded attempt of each image, by the image's time."""

    def __init__(
        self, maps: Sequence[PlaceMap], images: Iterable[LookedAt], tried: Sequence[TriedPicture] = ()
    ) -> None:
        """`tried`: the only map's own pictures."""
        self.maps = tuple(maps)
        self.tried = (tuple(tried),) if tried else ((),) * len(maps)
        self._attempts = {image.t_robot_ns: image.attempt for image in images}

    def attempt(self, frame: ImageFrame, calibration: Calibration, fit: CalibrationFit | None = None) -> Attempt:
        return self._attempts[frame.t_robot_ns]


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """What a tracker said of a drive."""

    answers: tuple[tuple[LookedAt, PlaceAnswer], ...]  # one per image, asked for when it has been looked at
    hijacks: tuple[HijackEvent, ...]


def play_back(
    place_map: PlaceMap,
    drive: RecordedDrive,
    make_tracker: MakeTracker = PlaceTracker,
    tried: Sequence[TriedPicture] = (),
) -> Played:
    """Feed a tracker with all that the robot sent; `tried`: the map's own pictures."""
    tracker = make_tracker([place_map], drive.calibration, PlayedBackLocalizer([place_map], drive.images, tried))
    camera = drive.calibration.camera
    shift_ns = round(1e9 * camera.time_shift_s) if camera else 0
    answers: list[tuple[LookedAt, PlaceAnswer]] = []
    hijacks: list[HijackEvent] = []
    for event in drive.events:
        if isinstance(event, ImuBatch):
            tracker.on_imu(event)
        elif isinstance(event, DriveSample):
            tracker.on_drive(event)
        elif isinstance(event, SlamPose):
            tracker.on_odometry(event.t_robot_ns, event.T_nav_body, event.segment)
        elif isinstance(event, SlamFit):
            tracker.on_calibration_fit(event.fit)
        else:
            tracker.on_frame(ImageFrame(len(answers), event.t_robot_ns, 0, b""))
            answers.append((event, tracker.answer(event.t_robot_ns + shift_ns)))
        hijacks += tracker.take_events()
    return Played(tuple(answers), tuple(hijacks))
