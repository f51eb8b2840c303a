"""The SLAM backends by name; each is imported only when chosen, since some need libraries a machine may lack."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from shared.advice import install
from shared.calibration import Calibration
from shared.errors import ConfigError
from station.config import AUTO, BACKENDS, choose_backend, load_factory
from station.slam.backend import SlamBackend

if TYPE_CHECKING:
    from station.slam.ukf.start.starter import GivenState


def make_backend(
    name: str,
    calibration: Calibration,
    seed: int = 0,
    threads: int = -1,
    intrinsics_known: bool = True,
    landmarks: Literal["default", "thesis"] = "default",
    initial_state: GivenState | None = None,
) -> SlamBackend:
    """A fresh backend for one navigation.

    Args:
        name: one of BACKENDS, "auto", or "package.module:factory" of one that takes a calibration alone.
        seed: of everything random in it.
        threads: 1 makes runs repeatable where threads would not be; -1 uses all cores.
        intrinsics_known: False where the camera's numbers are only a guess (refined where the backend can).
        landmarks: ukf only: "thesis" keeps each landmark as it first entered the filter.
        initial_state: ukf only: start from this state instead of by itself.
    Raises:
        ConfigError: unknown name, a library that is missing, or a calibration that the backend cannot use.
    """
    name = choose_backend(name, calibration)
    if name != "ukf" and (landmarks != "default" or initial_state is not None):
        raise ConfigError(f"backend {name} has no thesis landmarks and no initial state; use --backend ukf for them")
    if ":" in name:
        backend: SlamBackend = load_factory(name)(calibration)
        return backend
    try:
        if name == "sfm":
            from station.slam.sfm.backend import SfmBackend
            from station.slam.sfm.config import SfmConfig

            return SfmBackend(calibration, SfmConfig(seed=seed, threads=threads), intrinsics_known)
        if name == "ukf":
            from station.slam.ukf.backend import UkfBackend
            from station.slam.ukf.config import UkfConfig

            return UkfBackend(calibration, UkfConfig(landmarks=landmarks), seed, initial_state)
        if name == "smoothing":
            from station.slam.smoothing.backend import SmoothingBackend

            return SmoothingBackend(calibration, seed=seed)
        if name == "mono":
            from station.slam.mono.backend import MonoBackend

            return MonoBackend(calibration)
    except ImportError as exc:
        raise ConfigError(f"backend {name} needs {exc.name}, which is missing; run: {install('station')}") from exc
    raise ConfigError(f"backend {name!r} is unknown; choose one of {', '.join((AUTO, *BACKENDS))}")
