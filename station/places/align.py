"""T_map_nav: how a second navigation lies in the map's frame, with scale, or why that is not known."""

from __future__ import annotations

import numpy as np

from shared.geometry import FloatArray
from station.maps.map import PlaceMap
from station.navigation import Navigation
from station.places.config import PlacesConfig
from station.places.outliers import usable_landmarks
from station.places.registration import Rays, Registration, register_clouds
from station.places.registration.result import refused
from station.places.scale import viewing_distance
from station.places.thesis_registration import register_as_thesis

FREE_SCALE = 1.67  # two drives of one home differ in viewing distance by less than this factor


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
    return _align_by_geometry(target, source, seed=seed)


def _align_by_geometry(target: Navigation, source: Navigation, *, seed: int) -> Registration:
    units = viewing_distance(target), viewing_distance(source)
    if units[0] is None or units[1] is None:
        return refused("a cloud without a finite landmark cannot be registered", "small_gicp")
    p_target, rays_target = _cloud(target, units[0])
    p_source, rays_source = _cloud(source, units[1])
    both_upright = target.is_gravity_aligned and source.is_gravity_aligned
    ratio = units[0] / units[1]
    return register_clouds(
        p_target,
        p_source,
        scale="known" if target.is_metric and source.is_metric else "free",
        gravity="known" if both_upright else "unknown",
        seed=seed,
        target_rays=rays_target,
        source_rays=rays_source,
        scale_range=None if target.is_metric and source.is_metric else (ratio / FREE_SCALE, ratio * FREE_SCALE),
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
