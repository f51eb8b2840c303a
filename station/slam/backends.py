"""The SLAM backends by name; each is imported only when chosen, since some need libraries a machine may lack."""

from __future__ import annotations

from shared.calibration import Calibration
from shared.errors import ConfigError
from station.slam.backend import SlamBackend

BACKENDS = ("sfm", "ukf")


def make_backend(
    name: str, calibration: Calibration, seed: int = 0, threads: int = -1, intrinsics_known: bool = True
) -> SlamBackend:
    """A fresh backend for one navigation.

    Args:
        name: one of BACKENDS.
        seed: of everything random in it.
        threads: 1 makes runs repeatable where threads would not be; -1 uses all cores.
        intrinsics_known: False where the camera's numbers are only a guess (refined where the backend can).
    Raises:
        ConfigError: unknown name, a library that is missing, or a calibration that the backend cannot use.
    """
    try:
        if name == "sfm":
            from station.slam.sfm.backend import SfmBackend
            from station.slam.sfm.config import SfmConfig

            return SfmBackend(calibration, SfmConfig(seed=seed, threads=threads), intrinsics_known)
        if name == "ukf":
            from station.slam.ukf.backend import UkfBackend

            return UkfBackend(calibration, seed=seed)
    except ImportError as exc:
        raise ConfigError(
            f"backend {name} needs {exc.name}, which is not installed; run: pip install 'sentinel-robot[station]'"
        ) from exc
    raise ConfigError(f"backend {name!r} is unknown; choose one of {', '.join(BACKENDS)}")
