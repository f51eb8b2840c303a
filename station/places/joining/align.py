"""T_map_nav: how a second navigation lies in the map's frame, with scale, or why that is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import FloatArray, scale_of
from station.model.navigation import Navigation
from station.model.place_map import PlaceMap
from station.places.joining.appearance_alignment import AppearanceAlignment, align_by_appearance
from station.places.joining.thesis_registration import register_as_thesis
from station.places.making.config import PlacesConfig
from station.places.making.outliers import usable_landmarks
from station.places.making.scale import viewing_distance
from station.places.registration.free_space import Rays
from station.places.registration.register import register_clouds
from station.places.registration.result import Registration, refused

FREE_SCALE = 1.67  # two navigations of one home differ in viewing distance by less than this factor
NEAR_SCALE = 1.05  # images leave a scale open by less
METRIC_TO = 0.03  # how far a scale by wheels and IMU may be off (docs/registration.md)
MIN_OVERLAP = 0.15  # images that agree outweigh clouds that see little of each other, but not clouds apart


def align_navigation(
    place_map: PlaceMap, navigation: Navigation, config: PlacesConfig, *, seed: int = 0
) -> Registration:
    """Registration of the navigation's cloud (source) to the map's (target)."""
    target, source = place_map.navigation, navigation
    if config.mode == "thesis":
        normalise = config.thesis.normalise
        return register_as_thesis(
            target.landmarks.p_world,
            source.landmarks.p_world,
            config.thesis,
            normalise=not (target.is_metric and source.is_metric) if normalise is None else normalise,
        )
    units = viewing_distance(target), viewing_distance(source)
    if units[0] is None or units[1] is None:
        return refused(_why_no_length(target if units[0] is None else source), "small_gicp")
    clouds = _Clouds(target, source, (units[0], units[1]))
    if config.align_by != "geometry":
        found = align_by_appearance(
            place_map, navigation, viewing_distance=units[0], fixed_scale=target.is_metric and source.is_metric
        )
        if found is not None:
            return _check_by_geometry(found, clouds, seed)
        if config.align_by == "appearance":
            return refused("too few of the navigation's images were found in the map, or they disagree", "appearance")
    return clouds.register(seed)


def _why_no_length(navigation: Navigation) -> str:
    """Why a navigation has no viewing distance: it holds no cloud that could be registered."""
    p = navigation.landmarks.p_world
    finite = int(np.count_nonzero(np.isfinite(p).all(axis=1)))
    if finite:
        return f"the {finite} landmarks of {navigation.id} lie on one point and cannot be registered"
    return f"{navigation.id} has no finite landmark (of {len(p)}) and cannot be registered"


def _check_by_geometry(found: AppearanceAlignment, clouds: _Clouds, seed: int) -> Registration:
    """The motion the images agree on, unless the clouds have nothing to do with each other there.

    Clouds refined from there give the figures but not the motion: images fix scale and position several times
    better than sparse landmarks do (docs/places.md has the table).
    """
    by_clouds = clouds.register(seed, around=found.T_map_nav)
    agreement = f"{found.agreeing} of {found.found} images that were found in the map agree ({found.asked} were asked)"
    accepted = by_clouds.overlap >= MIN_OVERLAP
    reason = (
        "" if accepted else f"only {by_clouds.overlap:.0%} of the landmarks have a neighbour in the other cloud there"
    )
    return replace(
        by_clouds,
        accepted=accepted,
        reasons=(agreement,) if accepted else (agreement, reason),
        T_target_source=found.T_map_nav,
        scale=scale_of(found.T_map_nav),
        covariance=found.covariance,
        backend="appearance + small_gicp",
    )


class _Clouds:
    def __init__(self, target: Navigation, source: Navigation, units: tuple[float, float]) -> None:
        self._target, self._target_rays = _cloud(target, units[0])
        self._source, self._source_rays = _cloud(source, units[1])
        self._upright = target.is_gravity_aligned and source.is_gravity_aligned
        self._metric = target.is_metric and source.is_metric
        self._ratio = units[0] / units[1]

    def register(self, seed: int, around: FloatArray | None = None) -> Registration:
        """By global search, or refined `around` a known motion (4, 4)."""
        scale, spread = self._ratio, FREE_SCALE
        if around is not None:
            scale, spread = scale_of(around), NEAR_SCALE
        return register_clouds(
            self._target,
            self._source,
            scale="known" if self._metric else "free",
            gravity="known" if self._upright else "unknown",
            seed=seed,
            target_rays=self._target_rays,
            source_rays=self._source_rays,
            scale_range=None if self._metric else (scale / spread, scale * spread),
            start=() if around is None else (around,),
            known_to=METRIC_TO,
            search=around is None,
        )


def _cloud(navigation: Navigation, unit: float) -> tuple[FloatArray, Rays]:
    """Landmarks worth registering (n, 3) and the rays they were seen along."""
    landmarks = navigation.landmarks
    usable = usable_landmarks(navigation, unit)
    row = np.full(len(landmarks), -1, dtype=np.int64)
    row[usable] = np.arange(len(usable))
    kept = row[landmarks.observed_landmark] >= 0
    rays = Rays(
        viewpoints=navigation.keyframes.T_world_cam[:, :3, 3],
        viewpoint=landmarks.observed_keyframe[kept],
        point=row[landmarks.observed_landmark[kept]],
    )
    return landmarks.p_world[usable], rays
