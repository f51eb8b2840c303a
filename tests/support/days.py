"""Several navigations of one home on different days, furniture moved between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shared.geometry import FloatArray, se3, yaw_rotation
from station.datasets import Truth
from station.experiments.matches import true_landmarks
from station.files.navigation_folder import save_navigation
from tests.support.synthetic_home import Home, drive, furnished_room, navigate

DAYS = 3


@dataclass(frozen=True, slots=True)
class Drive:
    """A day's navigation in its folder, and where its landmarks truly are."""

    folder: Path
    p_true: FloatArray  # (M, 3)


def made_up_days(seed: int, folder: Path) -> list[Drive]:
    """The same of points in one room: two pieces of furniture stand elsewhere on each later day."""
    rng = np.random.default_rng(20_000 + seed)
    size = (float(rng.uniform(3.5, 6.5)), float(rng.uniform(3.0, 5.0)))
    home = furnished_room(seed, pieces=int(rng.integers(5, 11)), size=size, density=int(rng.integers(150, 700)))
    drives = []
    for day in range(DAYS):
        poses = drive(home, 10 * seed + day, frames=70, turns=float(rng.uniform(1, 2.5)))
        T = np.eye(4) if day == 0 else se3(yaw_rotation(rng.uniform(0, 2 * np.pi)), rng.uniform(-3, 3, 3))
        navigation = navigate(
            rearranged(home, rng) if day else home,
            poses,
            seed=10 * seed + day,
            name=f"room-{seed}-day-{day}",
            T_nav_world=T,
            noise_m=0.02,
        )
        save_navigation(navigation, folder / f"day-{day}")
        drives.append(Drive(folder / f"day-{day}", true_landmarks(navigation, truth_of(poses))))
    return drives


def rearranged(home: Home, rng: np.random.Generator) -> Home:
    """Two pieces of furniture pushed by up to a metre."""
    p = home.p.copy()
    for piece in rng.choice(home.furniture.max() + 1, 2, replace=False):
        p[home.furniture == piece, :2] += rng.uniform(-0.7, 0.7, 2)
    return replace(home, p=p)


def truth_of(poses: FloatArray) -> Truth:
    return Truth(np.arange(len(poses), dtype=np.int64) * 100_000_000, poses)
