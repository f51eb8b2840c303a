"""The equations of a whole navigation are sparse and solved as such; landmarks that lost nothing are not found anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.sparse import block_diag, bsr_matrix, csc_matrix

from shared.calibration import REFERENCE_CAMERA
from shared.geometry import FloatArray, homogeneous, inverse, se3, transform
from station.slam.mapping import odometry_bundle
from station.slam.mapping.odometry_bundle import MIN_FILLED, BundleState, adjust, factored, reprojection_errors
from station.slam.mapping.odometry_mapping import gather, observations, triangulate_and_prune
from station.slam.mapping.tracks import Tracks, longest
from station.vision.triangulation import MIN_DEPTH_M, MIN_PARALLAX_RAD, intersect_rays

GATE_PX = 4.0


def chain(num_poses: int, reach: int) -> csc_matrix:
    """Positive definite equations of poses that share landmarks with the next few, and the first with the last."""
    rng = np.random.default_rng(3)
    apart = np.abs(np.arange(num_poses)[:, None] - np.arange(num_poses))
    row, column = np.nonzero((apart <= reach) | (apart == num_poses - 1))
    begin = np.concatenate([[0], np.cumsum(np.bincount(row))])
    J = bsr_matrix((rng.normal(size=(len(row), 6, 6)), column, begin)).tocsc()
    return (J.T @ J + csc_matrix(np.eye(6 * num_poses))).tocsc()


@pytest.mark.parametrize("reach", [2, 40])  # 40: so many of them depend on each other that they are solved as full ones
def test_equations_are_solved_alike_as_sparse_and_as_full_ones(reach: int, monkeypatch: pytest.MonkeyPatch) -> None:
    S = chain(300, reach)
    assert (S.nnz > MIN_FILLED * S.shape[0] ** 2) == (reach == 40)
    rhs = np.random.default_rng(4).normal(size=(len(S.toarray()), 3))
    found = factored(S)(rhs)
    np.testing.assert_allclose(S @ found, rhs, atol=1e-9)
    monkeypatch.setattr(odometry_bundle, "MAX_DENSE", 0)
    np.testing.assert_allclose(factored(S)(rhs), found, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("max_dense", [4200, 0])
@pytest.mark.parametrize("least", [0.0, -1.0])  # eigenvalue
def test_equations_that_leave_something_open_are_refused(
    least: float, max_dense: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(odometry_bundle, "MAX_DENSE", max_dense)
    with pytest.raises(np.linalg.LinAlgError):
        factored(csc_matrix(np.diag([2.0, 1.0, least])))


@dataclass(frozen=True)
class Contradiction:
    """Two unknowns that are said to depend on each other more than on themselves, and poses that stay."""

    num_poses: int

    def cost(self, state: BundleState) -> float:
        return float(state.motion @ state.motion)

    def normal_equations(self, state: BundleState) -> tuple[csc_matrix, FloatArray]:
        poses = csc_matrix(np.eye(6 * self.num_poses))
        open_pair = csc_matrix(np.array([[1.0, 1.05], [1.05, 1.0]]))
        return block_diag([poses, open_pair], format="csc"), np.concatenate(
            [np.zeros(6 * self.num_poses), state.motion]
        )


@pytest.mark.parametrize("max_dense", [4200, 0])
def test_a_step_whose_equations_leave_something_open_is_made_smaller(
    max_dense: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(odometry_bundle, "MAX_DENSE", max_dense)
    state, tracks, rays = turned_views(0)
    kept, points = triangulate_and_prune(state, tracks, rays, REFERENCE_CAMERA, GATE_PX)
    state = replace(state, points=points, motion=np.array([1.0, 1.0]))
    motion = Contradiction(len(state.R_world_body))
    adjusted = adjust(state, observations(kept, rays, REFERENCE_CAMERA), motion, cauchy_px=1.0)
    assert np.linalg.norm(adjusted.motion) < 0.6 * np.linalg.norm(state.motion)


def turned_views(seed: int) -> tuple[BundleState, Tracks, list[FloatArray]]:
    """Twelve views of two hundred landmarks, most of which some views show; one in ten observations is wrong."""
    rng = np.random.default_rng(seed)
    n, m = 12, 200
    T_body = np.array([se3(np.eye(3), np.array([0.1 * k, 0.05 * k, 0.0])) for k in range(n)])
    points = rng.uniform([3, -1.5, -0.8], [6, 1.5, 0.8], (m, 3))
    is_seen = rng.random((n, m)) < 0.3
    keyframe, point = np.nonzero(is_seen)
    rays, feature = [], np.zeros(len(keyframe), dtype=np.int64)
    for k in range(n):
        mine = np.flatnonzero(keyframe == k)
        p_cam = transform(REFERENCE_CAMERA.T_cam_body_matrix @ inverse(T_body[k]), points[point[mine]])
        xy = p_cam[:, :2] / p_cam[:, 2:] + rng.normal(size=(len(mine), 2)) * 0.3 / REFERENCE_CAMERA.fx
        xy[rng.random(len(mine)) < 0.1] += 0.05
        rays.append(xy)
        feature[mine] = np.arange(len(mine))
    tracks = Tracks(keyframe, point, feature, m).only(np.ones(len(keyframe), dtype=bool))
    return BundleState(T_body[:, :3, :3], T_body[:, :3, 3], np.empty((0, 3)), np.zeros(0)), tracks, rays


def all_anew(state: BundleState, tracks: Tracks, rays: list[FloatArray]) -> tuple[Tracks, FloatArray]:
    """As `triangulate_and_prune`, with all landmarks found anew in each round."""
    T_body_cam = REFERENCE_CAMERA.T_body_cam_matrix
    R_cam = state.R_world_body @ T_body_cam[:3, :3]
    centre = state.p_world_body + state.R_world_body @ T_body_cam[:3, 3]

    def errors(points: FloatArray) -> FloatArray:
        return reprojection_errors(replace(state, points=points), observations(tracks, rays, REFERENCE_CAMERA))

    for _ in range(3):
        directions = np.einsum("nij,nj->ni", R_cam[tracks.keyframe], homogeneous(gather(tracks, rays)))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        points, defined = intersect_rays(tracks.point, tracks.num_points, centre[tracks.keyframe], directions)
        error = np.where(np.isfinite(errors(points)), errors(points), 1e9)
        good = defined[tracks.point] & (error < GATE_PX)
        if good.all():
            break
        worst = np.zeros(tracks.num_points)
        np.maximum.at(worst, tracks.point, error)
        drop = ((error >= worst[tracks.point]) & ~good) | ~defined[tracks.point]
        points, tracks = points[tracks.alive(~drop)], tracks.only(~drop)
    good = errors(points) < GATE_PX
    return tracks.only(good), points[tracks.alive(good)]


@pytest.mark.parametrize("seed", range(5))
def test_landmarks_that_lost_nothing_need_not_be_found_anew(seed: int) -> None:
    state, tracks, rays = turned_views(seed)
    kept, points = triangulate_and_prune(state, tracks, rays, REFERENCE_CAMERA, GATE_PX)
    expected, expected_points = all_anew(state, tracks, rays)
    assert len(kept.point) < len(tracks.point) and kept.num_points == expected.num_points > 100
    for name in ("keyframe", "point", "feature"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(expected, name))
    np.testing.assert_array_equal(points, expected_points)  # bit for bit


def test_no_landmark_is_found_where_none_is_seen() -> None:
    state, tracks, rays = turned_views(0)
    none = tracks.only(np.zeros(len(tracks.point), dtype=bool))
    kept, points = triangulate_and_prune(state, none, rays, REFERENCE_CAMERA, GATE_PX)
    assert kept.num_points == len(points) == 0


def test_rays_are_summed_in_their_order() -> None:
    """Bit for bit as one after the other."""
    rng = np.random.default_rng(8)
    point, centres = rng.integers(0, 40, 300), rng.normal(size=(300, 3))
    target = rng.uniform(5, 7, (40, 3))
    rays = target[point] - centres + rng.normal(scale=0.01, size=(300, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    A_each = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    A, b = np.zeros((40, 3, 3)), np.zeros((40, 3))
    for k, A_k, b_k in zip(point, A_each, np.einsum("nij,nj->ni", A_each, centres), strict=True):
        A[k] += A_k
        b[k] += b_k
    found, good = intersect_rays(point, 40, centres, rays)
    assert good.all() and np.linalg.eigvalsh(A).min() > MIN_PARALLAX_RAD**2 and MIN_DEPTH_M < 1
    np.testing.assert_array_equal(found, np.linalg.solve(A, b[:, :, None])[:, :, 0])


def test_the_longest_tracks_are_chosen_until_each_keyframe_has_enough() -> None:
    _, tracks, _ = turned_views(1)
    chosen = longest(tracks, 20)
    length = np.bincount(tracks.point, minlength=tracks.num_points)
    have = np.zeros(12, dtype=np.int64)
    for m in np.argsort(-length, kind="stable"):
        seen_from = tracks.keyframe[tracks.point == m]
        assert chosen[m] == (have[seen_from] < 20).any()
        have[seen_from] += chosen[m]
    assert have.min() >= 20
