"""Several navigations of one home → one to map: later ones are carried into the first one's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.errors import EstimationError
from shared.geometry import FloatArray, carry_poses
from station.model.best_camera import misfit_of, why_unsure_of
from station.model.navigation import Keyframes, Navigation, Trajectory, join_depth, join_maps
from station.places.joining.align import align_navigation
from station.places.making.build import build_map
from station.places.making.config import PlacesConfig

PAUSE_NS = 1_000_000_000  # put between two navigations: their clocks need not have been one


def merge_navigations(
    navigations: list[Navigation], config: PlacesConfig | None = None, *, seed: int = 0
) -> Navigation:
    """One navigation that holds all of them, in the frame and scale of the first.

    Raises:
        EstimationError: a navigation cannot be registered to those before it with certainty; says which and why.
    """
    merged = navigations[0]
    for navigation in navigations[1:]:
        found = align_navigation(build_map(merged, config=config), navigation, config or PlacesConfig(), seed=seed)
        if not found.accepted or found.T_target_source is None:
            raise EstimationError(
                f"{navigation.id} could not be placed in {merged.id} with certainty ({'; '.join(found.reasons)}); "
                "map it by itself, or drive through both parts once"
            )
        merged = append_navigation(merged, navigation, found.T_target_source)
    return merged


def append_navigation(first: Navigation, second: Navigation, T_first_second: FloatArray) -> Navigation:
    """Both navigations in the first's frame. T_first_second (4, 4) may carry a scale.

    Times and frame numbers of the second are moved behind the first's: each navigation counts its own.
    """
    last = [int(t.max(initial=0)) for t in (first.trajectory.t_robot_ns, first.keyframes.t_robot_ns)]
    times = second.trajectory.t_robot_ns, second.keyframes.t_robot_ns
    start = [int(t.min()) for t in times if len(t)]
    shift_ns = max(last) + PAUSE_NS - min(start, default=0)
    a, b = first.keyframes, second.keyframes
    carried = Keyframes(
        frame_index=b.frame_index + a.frame_index.max(initial=-1) + 1,
        t_robot_ns=b.t_robot_ns + shift_ns,
        T_world_cam=carry_poses(T_first_second, b.T_world_cam),
        encoded=b.encoded,
        segment=b.segment + a.segment.max(initial=-1) + 1,
    )
    keyframes, landmarks = join_maps([(a, first.landmarks), (carried, second.landmarks.moved(T_first_second))])
    trajectory = Trajectory(
        np.concatenate([first.trajectory.t_robot_ns, second.trajectory.t_robot_ns + shift_ns]),
        np.concatenate([first.trajectory.T_world_body, carry_poses(T_first_second, second.trajectory.T_world_body)]),
    )
    report = replace(
        first.report,
        frames=first.report.frames + second.report.frames,
        duration_s=first.report.duration_s + second.report.duration_s,
        landmarks=len(landmarks),
        tracking_lost_s=first.report.tracking_lost_s + second.report.tracking_lost_s,
        messages=(*first.report.messages, _joined_with(second)),
        unsure=first.report.unsure or why_unsure_of(second),  # the fit stays that of the camera it is kept with
    )
    depth = join_depth(first.depth, second.depth, shift_ns)
    return Navigation(f"{first.id}+{second.id}", first.calibration, trajectory, keyframes, landmarks, report, depth)


def _joined_with(second: Navigation) -> str:
    why = misfit_of(second.report)
    return f"joined with {second.id}" + (f", of which is said that {why}" if why else "")
