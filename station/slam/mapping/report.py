"""What a person should know of a run, as far as every backend that goes frame by frame knows it."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import cv2
import msgspec
import numpy as np
import scipy

from station.model.navigation import NavigationReport
from station.slam.mapping.intake import FrameIntake

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def plain_settings(config: DataclassInstance) -> dict[str, Any]:
    """As `navigation.json` holds them."""
    plain: dict[str, Any] = msgspec.to_builtins(asdict(config))
    return plain


def make_report(
    backend: str,
    intake: FrameIntake,
    config: DataclassInstance,
    lost_s: float,
    seed: int,
    is_metric: bool,
    messages: Sequence[str],
    refused: dict[str, int] | None = None,
) -> NavigationReport:
    """Times and the number of landmarks are filled in by others.

    Args:
        is_metric: scale and gravity are known; otherwise neither is.
        refused: how many of what were left out, beside images.
    """
    counts = (refused or {}) | {
        "images out of order": intake.out_of_order,
        "images that could not be decoded": intake.undecodable,
        "images without IMU samples": intake.without_imu,
    }
    return NavigationReport(
        backend=backend,
        frames=intake.used,
        duration_s=intake.elapsed_s,
        wall_s=0.0,
        realtime_factor=0.0,
        cpu_s=0.0,
        landmarks=0,
        tracking_lost_s=lost_s,
        scale="metric" if is_metric else "arbitrary",
        gravity_aligned=is_metric,
        seed=seed,
        versions={
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "opencv": cv2.__version__,
        },
        config=plain_settings(config),
        messages=(*messages, *(f"{count} {what}" for what, count in counts.items() if count)),
    )
