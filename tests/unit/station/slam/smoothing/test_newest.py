"""How a keyframe is carried on by the filter's motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shared.geometry import inverse, se3, so3_exp
from station.slam.smoothing.newest import NewestInFilter
from station.slam.ukf.filter.state import CORE, FilterState, add_clone, initial_state, remove_clone


def state_with_clones(frames: list[int]) -> FilterState:
    """Frames 0.1 m and 1 degree apart."""
    state = initial_state(0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.eye(CORE))
    for frame in frames:
        state = replace(state, R=so3_exp(np.radians([0.0, 0.0, 1.0 * frame])), x=np.array([0.1 * frame, 0.0, 0.0]))
        state = add_clone(state, frame)
    return state


def test_what_the_filter_corrects_once_a_keyframe_has_left_its_window_is_not_motion() -> None:
    newest = NewestInFilter(np.eye(4))
    state = state_with_clones([0, 1, 2, 3])
    moved = newest.moved(2, state)
    T_keyframe = se3(state.clone_R[2], state.clone_x[2])
    assert np.allclose(moved, inverse(T_keyframe) @ state.T_world_body)
    state = remove_clone(state, 2)
    for tilt_deg in (0.8, -0.5):  # everything that the filter still has turns and shifts at once
        E = so3_exp(np.radians([0.0, tilt_deg, 0.0]))
        shift = np.array([0.02, 0.0, 0.01])
        state = replace(
            state,
            R=E @ state.R,
            x=E @ state.x + shift,
            clone_R=E @ state.clone_R,
            clone_x=state.clone_x @ E.T + shift,
        )
        assert np.allclose(newest.moved(2, state), moved)
