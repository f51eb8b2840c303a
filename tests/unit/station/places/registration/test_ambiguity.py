"""Registration without gravity or scale, from either global start, and what an inlier ratio cannot see."""

from __future__ import annotations

import numpy as np
import pytest

from shared.geometry import FloatArray, inverse, se3, so3_exp, so3_log, transform, yaw_rotation
from station.places.registration import register, verify
from station.places.registration.free_space import Rays, watched_points
from station.places.registration.kiss import kiss_is_available, match_features
from station.places.registration.register import register_clouds
from station.places.registration.verify import MIN_WATCHED
from tests.support.registration_clouds import CloudPair, errors, make_pair

TUMBLED = se3(so3_exp(np.array([1.1, -0.7, 1.9])), np.array([2.0, -1.0, 0.5]))  # upside down, nearly
needs_kiss = pytest.mark.skipif(not kiss_is_available(), reason="KISS-Matcher has no wheel here")


@pytest.fixture(scope="module")
def pair() -> CloudPair:
    return make_pair(9003, overlap=(0.9, 1.0), points=(3000, 4000))


@pytest.mark.parametrize("start", ["own", pytest.param("KISS-Matcher", marks=needs_kiss)])
def test_where_up_is_unknown_either_global_start_alone_finds_the_motion(
    pair: CloudPair, start: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if start == "own":
        monkeypatch.setattr(register, "kiss_is_available", lambda: False)
    else:
        monkeypatch.setattr(register, "search_yaw", lambda *_, **__: [])
    # KISS-Matcher's features need most landmarks in both drives: of pairs that share half of them it finds half.
    rng = np.random.default_rng(1)
    again = pair.target[rng.random(len(pair.target)) < 0.8]
    source = transform(TUMBLED, again + rng.normal(0, 0.01, again.shape))
    result = register_clouds(pair.target, source, gravity="unknown")
    assert result.accepted, result.reasons
    rotation_deg, shift, _ = errors(result.T_target_source, inverse(TUMBLED), np.median(source, axis=0))
    assert rotation_deg < 2 and shift < 0.05


@needs_kiss
def test_kiss_matcher_gives_a_coarse_motion_and_prints_nothing(
    pair: CloudPair, capfd: pytest.CaptureFixture[str]
) -> None:
    found = match_features(pair.target, transform(TUMBLED, pair.target), upright=False, voxel=0.2)
    rotation_deg, shift, _ = errors(found, inverse(TUMBLED), transform(TUMBLED, pair.target).mean(axis=0))
    assert rotation_deg < 5 and shift < 0.4
    assert capfd.readouterr() == ("", "")  # it would stand before the JSON of `station register`


@pytest.mark.slow
def test_neither_gravity_nor_scale_known_all_seven_degrees_are_found(pair: CloudPair) -> None:
    assert pair.T_target_source is not None
    source = transform(TUMBLED, pair.source) / 1.15
    T_true = pair.T_target_source @ inverse(TUMBLED) @ np.diag([1.15, 1.15, 1.15, 1.0])
    result = register_clouds(pair.target, source, scale="free", gravity="unknown")
    assert result.accepted, result.reasons
    rotation_deg, shift, scale = errors(result.T_target_source, T_true, np.median(source, axis=0))
    assert rotation_deg < 2 and shift < 0.05 and scale < 0.01
    assert result.covariance is not None and result.covariance[6, 6] > 0
    assert result.eigenvalues is not None and len(result.eigenvalues) == 7


def test_a_room_that_looks_alike_from_both_ends_is_refused_with_the_alternative() -> None:
    half = make_pair(9010, overlap=(1.0, 1.0), points=(2000, 2001), noise_m=0.0, outliers=(0.0, 0.0)).target
    middle = np.append(half[:, :2].max(axis=0), 0.0)  # a corner: the halves touch there and share nothing else
    turned = (half - middle) @ yaw_rotation(np.pi).T + middle
    room = np.concatenate([half, turned])
    rng = np.random.default_rng(0)
    T_true = se3(yaw_rotation(0.8), np.array([1.0, 2.0, 0.0]))
    seen_again = transform(inverse(T_true), room + rng.normal(0, 0.01, room.shape))
    result = register_clouds(room, seen_again)
    assert not result.accepted and any("looks alike" in reason for reason in result.reasons), result.reasons
    assert result.T_target_source is not None and result.alternatives
    turn = result.alternatives[0].T_target_source[:3, :3] @ result.T_target_source[:3, :3].T
    assert np.degrees(np.linalg.norm(so3_log(turn))) > 175


def test_along_a_bare_corridor_the_clouds_can_slide() -> None:
    rng = np.random.default_rng(0)

    def corridor() -> FloatArray:
        p = rng.uniform([0, -0.8, 0], [12, 0.8, 2.4], (4000, 3))
        side = rng.integers(0, 3, len(p))
        p[side == 0, 1], p[side == 1, 1], p[side == 2, 2] = -0.8, 0.8, 0.0
        return p + rng.normal(0, 0.01, p.shape)

    result = register_clouds(corridor(), corridor())
    assert not result.accepted
    assert result.eigenvalues is not None and result.eigenvalues[0] < 0.1 * np.median(result.eigenvalues)


def wall_seen_through(depth: float) -> tuple[FloatArray, FloatArray, Rays]:
    """A wall at 4 m, points of another cloud at `depth` before the same camera, and who saw the wall."""
    y, z = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 30)))
    wall = np.column_stack([np.full(len(y), 4.0), y, z])
    rays = Rays(np.zeros((1, 3)), np.zeros(len(wall), np.int64), np.arange(len(wall)))
    return wall, wall * (depth / 4.0), rays


@pytest.mark.parametrize(("depth", "share"), [(2.0, 1.0), (4.0, 0.0)])
def test_what_would_hang_where_the_other_drive_saw_through_is_counted(depth: float, share: float) -> None:
    wall, other, rays = wall_seen_through(depth)
    watched = watched_points(wall, rays, other, 0.2, np.random.default_rng(0))
    assert watched.share == pytest.approx(share, abs=0.05) and watched.points > 0.9 * len(other)


def test_free_space_says_nothing_of_what_nobody_watched() -> None:
    wall, other, rays = wall_seen_through(2.0)
    elsewhere = watched_points(wall, rays, other + np.array([0.0, 50.0, 0.0]), 0.2, np.random.default_rng(0))
    assert elsewhere.points == 0 and np.isnan(elsewhere.share)
    nowhere = Rays(np.full((1, 3), np.nan), rays.viewpoint, rays.point)
    assert watched_points(wall, nowhere, other, 0.2, np.random.default_rng(0)).points == 0


def test_an_alignment_through_which_the_other_drive_looked_is_refused_unless_few_points_say_so(
    pair: CloudPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same pair; sixty landmarks far above were seen from below, through whatever the alignment puts there."""
    below = pair.target[:: len(pair.target) // 60][:60]
    target = np.concatenate([pair.target, below + np.array([0.0, 0.0, 8.0])])
    far = len(pair.target) + np.arange(60)
    rays = Rays(below - np.array([0.0, 0.0, 3.0]), np.repeat(np.arange(60), 3), np.repeat(far, 3))
    without = register_clouds(target, pair.source)
    assert without.accepted and "free-space violation" not in without.measured
    result = register_clouds(target, pair.source, target_rays=rays)
    assert not result.accepted
    [reason] = result.reasons
    assert "saw through empty space" in reason
    share, points = result.measured["free-space violation"], result.measured["watched points"]
    assert f"{share:.0%} of the points" in reason and points >= MIN_WATCHED
    monkeypatch.setattr(verify, "MIN_WATCHED", points + 1)
    of_few = register_clouds(target, pair.source, target_rays=rays)
    assert of_few.accepted and of_few.measured["free-space violation"] == share  # measured, but no reason
