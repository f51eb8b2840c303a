"""What an image counts beside others: furniture that comes twice deceives each image of it, an arrangement does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.geometry import FloatArray, IntArray, median_radius
from station.places.tracking.belief import NOTHING
from tests.support.places import SECOND, estimator_of, make_map, pose, seen

SEEN = 200  # landmarks of a wall
WALL = np.stack([np.zeros(SEEN), np.linspace(-0.8, 0.8, SEEN), np.full(SEEN, 0.5)], axis=1)
MIDDLE = np.array([6.5, 0.0, 0.5])  # of what deceives, half a metre before the pose at x = 6 where it would be right
HERE, THERE = pose(0.0, 0.0), pose(6.0, 0.0)


class Robot:
    """Turns on the spot at Place 0 (x = 0) and sees things there, and what looks like `things` (n, 3) of Place 2."""

    def __init__(self, things: FloatArray, scale: float | None = None) -> None:
        self.estimator = estimator_of(make_map(more=np.concatenate([WALL, things]), scale=scale))
        self.p = np.concatenate([make_map().navigation.landmarks.p_world, WALL, things])
        self.things = np.arange(3 + SEEN, 3 + SEEN + len(things))
        self.scale = 1.0 if scale is None else scale
        self.yaw = 0.0
        self.t_s = 0.0
        self.estimator.on_odometry(0, HERE)

    def shown(
        self, landmarks: IntArray, T_map_body: FloatArray, extent: float | None = None, after_s: float = 1.0
    ) -> None:
        """Turn to another view (unless no time passes), and recognise these as if from this pose."""
        self.wait(after_s)
        self.image(self.t_s, landmarks, T_map_body, extent)

    def wait(self, seconds: float) -> None:
        """Turn on; odometry tells of it all the time."""
        steps = int(np.ceil(2 * seconds))
        for _ in range(steps):
            self.t_s += seconds / steps
            self.yaw += 0.3 / steps
            self.estimator.on_odometry(round(self.t_s * SECOND), pose(0.0, 0.0, self.yaw))

    def image(self, t_s: float, landmarks: IntArray, T_map_body: FloatArray, extent: float | None = None) -> None:
        T = T_map_body @ pose(0.0, 0.0, self.yaw)
        T[:3, 3] *= self.scale
        z = seen(
            t_s,
            T,
            inliers=len(landmarks),
            landmarks=tuple(int(k) for k in landmarks),
            extent=self.scale * (median_radius(self.p[landmarks]) if extent is None else extent),
        )
        self.estimator.on_candidates([replace(z, sigma_position=0.03 * self.scale)])

    def tracked(self, views: int = 3) -> Robot:
        """Certain to be at Place 0."""
        for _ in range(views):
            self.shown(np.arange(3, 3 + SEEN), HERE)
        assert self.here > 0.95
        return self

    @property
    def here(self) -> float:
        return float(self.estimator.place_probabilities().place[0])

    @property
    def elsewhere(self) -> float:
        return float(self.estimator.place_probabilities().place[1:].sum())

    @property
    def known(self) -> str | None:
        place = self.estimator.answer(round(self.t_s * SECOND)).place
        return None if place is None else place.id

    @property
    def log_odds(self) -> float:
        """That the robot is elsewhere, against that it is here."""
        return float(np.log(self.elsewhere / self.here))


def piece(count: int, half_m: float = 0.15, seed: int = 0) -> FloatArray:
    """Landmarks (count, 3) throughout one piece of furniture."""
    return MIDDLE + np.random.default_rng(seed).uniform(-half_m, half_m, (count, 3))


def after_one_image(things: FloatArray, extent: float | None = None) -> Robot:
    """For comparison: all of it recognised at once."""
    robot = Robot(things).tracked()
    robot.shown(robot.things, THERE, extent)
    return robot


@pytest.mark.parametrize("images", [20, 40])
@pytest.mark.parametrize("extent", [0.065, 0.08, 0.09, 0.1, 0.15])
def test_many_small_images_of_one_piece_say_no_more_than_one_of_the_whole(extent: float, images: int) -> None:
    robot = Robot(piece(60 * images)).tracked()
    for bit in np.split(robot.things, images):
        robot.shown(bit, THERE, extent)
    whole = piece(60 * images)
    assert robot.elsewhere < after_one_image(whole, max(extent, median_radius(whole))).elsewhere + 0.01
    assert robot.elsewhere < 0.2 and robot.here > 0.75


@pytest.mark.parametrize("images", [8, 20, 40])
def test_dense_and_wide_views_in_turn_say_no_more_than_one_wide_view(images: int) -> None:
    rng = np.random.default_rng(0)
    dense = [MIDDLE + rng.uniform(-0.13, 0.13, (200, 3)) for _ in range(images // 2)]
    ends = np.array([0.0, 0.28, 0.0])
    wide = [
        MIDDLE + np.repeat([ends, -ends], 10, axis=0) + rng.uniform(-0.05, 0.05, (20, 3)) for _ in range(images // 2)
    ]
    robot = Robot(np.concatenate(dense + wide)).tracked()
    for k in range(images // 2):
        first = 200 * (images // 2) + 20 * k
        robot.shown(robot.things[200 * k : 200 * (k + 1)], THERE)
        robot.shown(robot.things[first : first + 20], THERE)
    assert robot.elsewhere <= after_one_image(wide[0]).elsewhere
    assert robot.here > robot.elsewhere


def test_a_certain_robot_believes_furniture_over_two_metres_and_more() -> None:
    for length_m in (2.0, 2.5, 3.0):
        rng = np.random.default_rng(0)
        pieces = [piece(60, seed=k) + np.array([0.0, y, 0.0]) for k, y in enumerate(np.linspace(0.0, length_m, 8))]
        robot = Robot(np.concatenate([pieces[k] for k in rng.permutation(8)])).tracked()
        for bit in np.split(robot.things, 8):
            robot.shown(bit, THERE, 0.15)
        assert robot.known == "map-2"


def test_what_is_larger_than_any_look_alike_has_no_budget() -> None:
    robot = Robot(piece(600, half_m=0.5)).tracked()
    for k, bit in enumerate(np.split(robot.things, 10)):
        robot.shown(bit, THERE, 0.3)
        assert k > 0 or robot.known != "map-2"
    assert robot.elsewhere > 0.999
    assert after_one_image(piece(600, half_m=0.5)).elsewhere < 0.9  # more than all of it at once


def test_what_stands_beside_a_print_of_many_corners_counts_as_it_does_without() -> None:
    """A window and a shelf two metres apart are no piece of furniture, whatever was seen between them."""
    aside = np.array([0.0, 1.2, 0.0])
    window, shelf = piece(14, half_m=0.3, seed=1) - aside, piece(20, half_m=0.3, seed=2) + aside

    def gained_by_the_shelf(*, is_print_seen: bool) -> float:
        robot = Robot(np.concatenate([window, shelf, piece(300, half_m=0.04)])).tracked()
        of_window, of_shelf, of_print = np.split(robot.things, [14, 34])
        robot.shown(of_window, THERE, 0.3)
        if is_print_seen:
            robot.shown(of_print, THERE, 0.04)
        before = robot.log_odds
        robot.shown(of_shelf, THERE, 0.3)
        return robot.log_odds - before

    without = gained_by_the_shelf(is_print_seen=False)
    assert without > 1.0
    assert gained_by_the_shelf(is_print_seen=True) == pytest.approx(without, rel=0.2)


def test_what_stands_between_two_prints_counts_as_it_does_without() -> None:
    aside = np.array([0.0, 1.5, 0.0])
    prints = [piece(60, half_m=0.04, seed=k) + sign * aside for k, sign in enumerate((1, -1))]
    between = [piece(40, half_m=0.5, seed=2), piece(20, half_m=0.3, seed=3)]
    robot = Robot(np.concatenate([*prints, *between])).tracked()
    robot.shown(robot.things[:160], THERE)
    before = robot.log_odds
    robot.shown(robot.things[160:], THERE)
    assert robot.log_odds > before + 1.0


@given(st.integers(0, 1000), st.integers(2, 5))
def test_a_corner_that_was_mapped_several_times_makes_nothing_smaller(seed: int, times: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1.0, 1.0, (30, 3))
    again = np.concatenate([p, *([p[:10]] * times)])  # of ten corners there are several landmarks
    once, often = (NOTHING.and_then(np.arange(len(q)), 1) for q in (p, again))
    assert often.extent(again, cell=1e-6) >= once.extent(p, cell=1e-6)


@pytest.mark.parametrize("half_m", [0.15, 0.6])
def test_the_same_landmarks_in_another_view_are_hardly_news(half_m: float) -> None:
    robot = Robot(piece(60, half_m)).tracked()
    robot.shown(robot.things, THERE)
    once = robot.log_odds
    for _ in range(4):
        robot.shown(robot.things, THERE)
    assert robot.log_odds == pytest.approx(once, abs=0.5)  # an image like it counts 2.3 (furniture) or 4.6 (a wall)


@pytest.mark.parametrize("scatter_m", [0.2, 0.3, 0.6])
@pytest.mark.parametrize("half_m", [0.15, 0.3, 0.6])
def test_the_same_landmarks_at_poses_that_scatter_count_once(half_m: float, scatter_m: float) -> None:
    robot = Robot(piece(60, half_m)).tracked()
    robot.shown(robot.things, THERE)
    once = robot.log_odds
    for k in range(20):
        robot.shown(robot.things, pose(6.0 - scatter_m * (k % 5), scatter_m * (k % 3 - 1)))
    assert robot.log_odds < once + 20 * 0.02 * np.log(49 / 0.5)  # in full each, it were fifty times as much
    assert robot.here > 0.75 or half_m > 0.15


def test_landmarks_are_news_again_when_the_memory_ends_and_not_before() -> None:
    robot = Robot(piece(60)).tracked()
    robot.shown(robot.things, THERE)
    once = robot.log_odds
    robot.shown(robot.things, THERE, after_s=14.9)
    assert robot.log_odds == pytest.approx(once, abs=0.05)
    robot.shown(robot.things, THERE, after_s=15.1)
    assert robot.log_odds > once + 0.7


def test_after_the_memory_s_end_the_budget_begins_anew() -> None:
    robot = Robot(piece(240)).tracked()
    bits = np.split(robot.things, 4)
    gained = []
    for first, second in ((bits[0], bits[1]), (bits[2], bits[3])):
        robot.shown(first, THERE, 0.085)
        before = robot.log_odds
        robot.shown(second, THERE, 0.16)
        gained.append(robot.log_odds - before)
        robot.wait(15.1)
    assert gained[0] > 0.5
    assert gained[1] == pytest.approx(gained[0], abs=0.15)


def test_a_late_image_does_not_make_a_landmark_older() -> None:
    assert NOTHING.and_then(np.array([7]), 10).and_then(np.array([7]), 2).lately(5, memory_s=0.0).seen == {7: 10}
    robot = Robot(piece(60)).tracked()
    robot.wait(9.0)
    robot.shown(robot.things, THERE)
    robot.image(robot.t_s - 6.0, robot.things, THERE)
    once = robot.log_odds
    robot.shown(robot.things, THERE, after_s=12.0)  # 18 s after the late one
    assert robot.log_odds == pytest.approx(once, abs=0.1)


def test_put_back_where_it_was_the_robot_is_known_with_the_first_image() -> None:
    robot = Robot(piece(60)).tracked(6)
    for _ in range(2):
        robot.estimator.on_hijack(round(robot.t_s * SECOND), "lifted")
        assert robot.known is None and robot.here < 0.3
        robot.shown(np.arange(3, 3 + SEEN), HERE)
        assert robot.known == "map-0" and robot.here > 0.95


def test_put_down_at_another_place_the_robot_is_known_there_with_the_first_image() -> None:
    robot = Robot(piece(160, half_m=0.6)).tracked(6)
    robot.estimator.on_hijack(round(robot.t_s * SECOND), "lifted")
    robot.shown(robot.things, THERE)
    assert robot.known == "map-2"


def test_what_deceived_before_a_hijack_does_not_convince_after_it() -> None:
    robot = Robot(piece(60)).tracked()
    robot.shown(robot.things, THERE)
    robot.estimator.on_hijack(round(robot.t_s * SECOND), "lifted")
    for _ in range(5):
        robot.shown(robot.things, THERE)
        assert robot.known is None and robot.estimator.place_probabilities().place[2] < 0.5


def test_what_an_image_counts_for_a_look_alike_is_not_counted_for_its_right_pose() -> None:
    """The first image shows more of the look-alike; from then on the right pose is seen better and better."""
    robot = Robot(piece(34, 0.9))
    robot.wait(1.0)
    wall = np.random.default_rng(0).permutation(np.arange(3, 3 + SEEN))
    candidates = []
    for landmarks, T_map_body, extent in ((robot.things, THERE, 0.95), (wall[:14], HERE, 0.19)):
        T = T_map_body @ pose(0.0, 0.0, robot.yaw)
        z = seen(robot.t_s, T, inliers=len(landmarks), landmarks=tuple(int(k) for k in landmarks), extent=extent)
        candidates.append(replace(z, sigma_position=0.03))
    robot.estimator.on_candidates(candidates)
    assert robot.elsewhere > 0.5 and robot.here < 0.3
    for bit in np.split(wall[14:134], 2):
        robot.shown(bit, HERE, 0.5)
    assert robot.known == "map-0"


def test_a_stray_pose_of_before_a_hijack_does_not_hide_where_the_robot_was_put_down() -> None:
    """It may lie near by chance."""
    beliefs = []
    for stray in (False, True):
        robot = Robot(np.concatenate([piece(10), piece(120, 0.5)])).tracked()
        if stray:
            robot.shown(robot.things[:10], pose(6.0, 0.35), 0.05)
        robot.tracked(6)
        robot.estimator.on_hijack(round(robot.t_s * SECOND), "lifted")
        for bit in np.split(robot.things[10:], 3):
            robot.shown(bit, THERE, 0.12)
        beliefs.append(float(robot.estimator.place_probabilities().place[2]))
    without, with_stray = beliefs
    assert without > 0.5 and with_stray > 0.5


def test_after_a_hijack_what_speaks_for_the_old_pose_a_second_time_may_be_deceived_as_the_first_was() -> None:
    robot = Robot(piece(120)).tracked(6)
    robot.estimator.on_hijack(round(robot.t_s * SECOND), "lifted")
    robot.shown(robot.things[:60], HERE, 0.07)  # more often wrong than right
    assert robot.known is None and robot.here > 0.2
    robot.shown(robot.things[60:], HERE, 0.08)
    assert robot.known is None


@pytest.mark.parametrize("scale", [0.1, 10.0])
def test_the_unit_of_the_map_changes_nothing(scale: float) -> None:
    beliefs: list[list[FloatArray]] = []
    for s in (1.0, scale):
        robot = Robot(piece(300), scale=s).tracked()
        beliefs.append([])
        for k, bit in enumerate(np.split(robot.things, 5)):
            robot.shown(bit, THERE, 0.08 + 0.02 * k)
            beliefs[-1].append(robot.estimator.place_probabilities().place)
    np.testing.assert_allclose(beliefs[1], beliefs[0], rtol=1e-6)
    assert not np.allclose(beliefs[0][-1], beliefs[0][0], rtol=0.1)  # some of it counted


def parts(q: FloatArray) -> dict[str, Callable[[np.random.Generator, int], IntArray]]:
    """Ways to see `count` of a piece's landmarks q (n, 3) in its own frame, edges at -1 and 1."""
    return {
        "any": lambda rng, count: rng.choice(len(q), count, replace=False),
        "side": lambda rng, count: np.argsort(np.abs(q - q[rng.integers(len(q))]).max(axis=1))[:count],
        "rim": lambda rng, count: np.argsort(-np.abs(q).max(axis=1))[:count],
        "middle": lambda rng, count: np.argsort(np.abs(q).max(axis=1))[:count],
    }


VIEWS = st.lists(
    st.tuples(
        st.sampled_from(sorted(parts(np.zeros((1, 3))))),
        st.floats(0.1, 1.0),  # share of the landmarks
        st.floats(0.3, 3.0),  # seconds since the last one
    ),
    min_size=4,
    max_size=25,
)


@settings(max_examples=40, deadline=None)
@given(
    views=VIEWS,
    half=st.tuples(*[st.sampled_from([0.15, 0.1, 0.03])] * 3),
    is_hollow=st.booleans(),
    scatter_m=st.sampled_from([0.0, 0.05, 0.3, 1.0]),
    seed=st.integers(0, 10_000),
)
def test_however_one_piece_is_shown_a_certain_robot_never_goes_over_to_it(
    views: list[tuple[str, float, float]],
    half: tuple[float, float, float],
    is_hollow: bool,
    scatter_m: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, (200, 3))
    if is_hollow:
        q[np.arange(200), rng.integers(0, 3, 200)] = rng.choice([-1, 1], 200)
    robot = Robot(MIDDLE + q * half).tracked()
    for part, share, after_s in views:
        shown = robot.things[parts(q)[part](rng, round(200 * share))]
        robot.shown(
            shown, pose(*([6.0, 0.0] + scatter_m * rng.normal(size=2)), scatter_m * rng.normal()), None, after_s
        )
        assert robot.known in (None, "map-0")
