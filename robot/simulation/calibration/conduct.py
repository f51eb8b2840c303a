"""How a calibration recording is made: well, or with one of the mistakes that people make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType

from robot.simulation.calibration.board_camera import Optics
from robot.simulation.calibration.waving import Wave
from shared.errors import ConfigError


class Kind(StrEnum):
    """What is to be calibrated."""

    CAMERA = "camera"  # stills of a board moved before the camera
    CAMERA_IMU = "camera-imu"  # camera and IMU waved before a board on the wall
    IMU = "imu"  # an IMU at rest, no images


LIVELY, STILL = Wave(), Wave(turn_deg=(0.15, 0.15, 0.15), distance_share=0.0, aside_share=0.0)
LIT, DARK, DEFOCUSED = Optics(), Optics(light=0.02), Optics(lens_blur_px=6.0)


@dataclass(frozen=True)
class Conduct:
    """How one recording is made; the defaults do it well."""

    seconds: float
    wave: Wave = LIVELY
    optics: Optics = LIT
    fill: float = 0.62  # share of the image's height that the board takes, on average
    tilt_deg: float = 40.0  # of the board against the image plane in stills, at most
    spread: float = 1.0  # in stills the board's centre gets to this share of the way to the image's edges
    hand_speed: float = 1.0  # how fast the board still moves while a still is taken
    size_error: float = 1.0  # true length of what target.yaml calls 1 m
    bend_share: float = 0.0  # how far the board bulges, as a share of its width
    slips_m: float = 0.0  # the board slips down the wall by that much halfway through
    has_imu: bool = True
    sway_rad_s: float = 0.0  # rate at which the resting IMU sways, as in a hand
    is_knocked: bool = False


_CAMERA, _CAMERA_IMU, _IMU = Conduct(seconds=60.0), Conduct(seconds=30.0), Conduct(seconds=1800.0)
GOOD: Mapping[Kind, Conduct] = MappingProxyType({Kind.CAMERA: _CAMERA, Kind.CAMERA_IMU: _CAMERA_IMU, Kind.IMU: _IMU})
POOR: Mapping[Kind, Mapping[str, Conduct]] = MappingProxyType(
    {
        Kind.CAMERA: {
            "too-few": replace(_CAMERA, seconds=4.0),
            "too-dark": replace(_CAMERA, optics=DARK),
            "too-far": replace(_CAMERA, fill=0.13),
            "one-orientation": replace(_CAMERA, tilt_deg=1.0),
            "defocused": replace(_CAMERA, optics=DEFOCUSED),
            "shaken": replace(_CAMERA, hand_speed=25.0, optics=Optics(exposure_s=0.03)),
            "bent-board": replace(_CAMERA, bend_share=0.06),
            "middle-only": replace(_CAMERA, fill=0.3, spread=0.1),
        },
        Kind.CAMERA_IMU: {
            "too-short": replace(_CAMERA_IMU, seconds=3.0),
            "too-still": replace(_CAMERA_IMU, wave=STILL),
            "too-dark": replace(_CAMERA_IMU, optics=DARK),
            "too-far": replace(_CAMERA_IMU, fill=0.13),
            "one-axis": replace(_CAMERA_IMU, wave=Wave(turn_deg=(0.0, 0.0, 25.0))),
            "wrong-target-size": replace(_CAMERA_IMU, size_error=0.9),
            "defocused": replace(_CAMERA_IMU, optics=DEFOCUSED),
            "no-imu": replace(_CAMERA_IMU, has_imu=False),
            "bent-board": replace(_CAMERA_IMU, bend_share=0.06),
            "moved-board": replace(_CAMERA_IMU, slips_m=0.03),
        },
        Kind.IMU: {
            "too-short": replace(_IMU, seconds=10.0),
            "in-hand": replace(_IMU, sway_rad_s=0.02),
            "knocked": replace(_IMU, is_knocked=True),
        },
    }
)


def conduct_of(kind: Kind, poor: str | None, seconds: float | None) -> Conduct:
    """The good way to make such a recording or one that is poor by name. Raises ConfigError for an unknown name."""
    if poor is not None and poor not in POOR[kind]:
        raise ConfigError(f"no poor recording of kind {kind} is called {poor}; choose {', '.join(POOR[kind])}")
    conduct = POOR[kind][poor] if poor else GOOD[kind]
    return conduct if seconds is None else replace(conduct, seconds=seconds)
