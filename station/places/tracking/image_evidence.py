"""How probable an image is, wherever the robot may be: the one model of images' evidence.

An image gives verified poses, of which at most one is true, or it is not recognised. Either becomes an
`ImageLikelihood`, and that is all the filter (`filter.py`) ever sees of an image: its likelihood at each hypothesis,
somewhere in a map, and where no map knows. Its fitted numbers lie in `fitted.json`; docs/localisation.md explains it.

Images are not independent: a piece of furniture that looks like another one deceives every image of it. So an image
counts for what it recognises that was not recognised before, and small things together have one budget.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from shared.calibration import Calibration
from shared.geometry import FloatArray, inverse, so3_log
from station.model.best_camera import best_camera, is_of_robot
from station.model.navigation import Landmarks
from station.model.place_answer import Localization
from station.motion.head import AHEAD, Aim
from station.places.making.scale import USUAL_VIEWING_M
from station.places.space.space import CELL_M
from station.places.tracking.alike import Alike
from station.places.tracking.belief import (
    FREEDOM,
    NOTHING,
    SAME_POSE,
    Agreement,
    Belief,
    Hypothesis,
    PoseMeasurement,
    Recognised,
)
from station.places.tracking.config import BeliefConfig
from station.places.tracking.fitted import FailureOdds, RecognisedOdds, Usual
from station.places.tracking.map_view import MapView
from station.places.tracking.twins import Twins

LEAST_EXTENT_M = 0.01  # a smaller one has no logarithm to speak of
LITTLE = 5.0  # landmarks: added, so that a view of nothing has a logarithm


@dataclass(frozen=True, slots=True)
class MatchFigures:
    """The figures of a verified pose by which a right one differs from a look-alike's. None: nobody knows."""

    extent_m: float  # median distance of the recognised landmarks from their middle
    inliers: int
    support: float | None  # share of the landmarks that should be in view which was recognised
    features: int  # of the whole image
    off_floor: float | None  # of a robot on wheels: squared Mahalanobis distance from standing on the floor, upright
    is_free: bool  # the map knows its way there

    def or_usual(self, usual: Usual) -> MatchFigures:
        """What nobody knows taken for what is usual."""
        support = usual.support if self.support is None else self.support
        off_floor = usual.off_floor if self.off_floor is None else self.off_floor
        return replace(self, support=support, off_floor=off_floor)


@dataclass(frozen=True, slots=True)
class Correction:
    """A candidate that a hypothesis may be corrected by."""

    candidate: int
    fit: Agreement
    probability: float  # that it is right, were the hypothesis true: else the image is false


@dataclass(frozen=True, slots=True, eq=False)
class ImageLikelihood:
    """What an image says to a belief: a factor on every weight, and where it may have been taken."""

    at: Sequence[float]  # (H,) if the robot is at each hypothesis
    lost: float
    unmapped: float
    candidates: Sequence[PoseMeasurement] = ()  # (C,) none of an image that was not recognised
    found: FloatArray = field(default_factory=lambda: np.zeros(0))  # (C,) share of the lost weight that goes to each
    corrects: Sequence[Correction | None] = ()  # (H,) None: by no candidate
    expected_by: Sequence[int | None] = ()  # (C,) the hypothesis that a candidate fits; None: it is a new one
    counted_log_odds: FloatArray = field(default_factory=lambda: np.zeros(0))  # (C,) that it counts for each
    alike: Sequence[Alike] = ()  # (H,) what each hypothesis has in common with others after the image (`twins.py`)


class ImageEvidence:
    """Likelihoods of one robot's images in the active maps."""

    def __init__(
        self,
        maps: Sequence[MapView],
        calibration: Calibration | None,
        config: BeliefConfig,
        own: Sequence[float] | None = None,
    ) -> None:
        """`own`: of each map, what its own pictures add to the log odds of poses (`own_pictures.py`)."""
        self._maps = maps
        self._own = [0.0] * len(maps) if own is None else own
        camera = calibration.camera if calibration else None
        has_wheels = calibration is not None and calibration.has_wheels
        self._index = {view.place_map.id: i for i, view in enumerate(maps)}
        # By which images are looked for in each map: the mounting of a map's own robot was corrected with its poses.
        self._cameras = [best_camera(camera, view.place_map.navigation) if camera else None for view in maps]
        # How high a robot's body stands is known of the map's own robot.
        self._floors = [
            view.floor if has_wheels and is_of_robot(view.place_map.navigation, camera) else None for view in maps
        ]
        self._half_view = float(np.arctan(0.5 * camera.width / camera.fx)) if camera else 0.0
        self.config = config

    # -- an image that was recognised -----------------------------------------------------------------------------

    def of_candidates(
        self, localizations: Sequence[Localization], before: Belief, T_nav_body: FloatArray, aim: Aim = AHEAD
    ) -> ImageLikelihood:
        """The likelihood of an image that was taken at one of several poses, or at none of them ("false").

        At a hypothesis it is a mixture: the candidates' densities (Student's t) there; a uniform one; and,
        as what looks alike deceives again and again, the candidates' densities at the pose of another hypothesis, as
        far as that one is a look-alike's. Where no map knows, a first candidate is as likely as strays are there.
        """
        c = self.config
        candidates = [self.measured(z, aim) for z in localizations]
        figures = [self.figures(m).or_usual(c.fitted.usual) for m in candidates]
        odds = np.exp([self._log_odds(m, f) for m, f in zip(candidates, figures, strict=True)])
        false = max(1.0 / (1.0 + float(odds.sum())), c.false_localization_floor)
        share = odds / odds.sum()
        fits = [[self._fit(h, m, T_nav_body) for m in candidates] for h in before.hypotheses]
        density = np.array([[fit.density for fit in row] for row in fits]).reshape(len(fits), len(candidates)) * share
        at = density.sum(axis=1)  # of the image, at each hypothesis
        repeats = at * np.array([h.look_alike for h in before.hypotheses])
        again = c.deceived_again
        surely = 1 / c.false_localization_floor - 1  # odds: no look-alike furniture is as large
        # Log odds of each, for a hypothesis that it fits: half of the look-alikes fit nothing.
        worth = np.log(np.minimum(odds, surely) / again)
        expected_by = [_expected_by(fits, j) for j in range(len(candidates))]
        expecting = [None if i is None else before.hypotheses[i] for i in expected_by]
        together = [self._odds_together(*of_one) for of_one in zip(candidates, figures, expecting, strict=True)]
        novelty = self._novelty(candidates, together, before, expecting, worth)
        # Of the image on the whole: that of the candidates that are probably true.
        believed = share * [before.lost if h is None else h.weight for h in expecting]
        freshness = float(np.average(novelty, weights=believed + 1e-12))
        large = np.exp(np.minimum(np.array(together) - np.log(surely), 0.0))
        twins = Twins(before.hypotheses, fits, share, large, freshness)
        at *= twins.tempering
        density *= twins.tempering[:, None]
        fails = [1.0] * len(before.hypotheses)  # asked only where it matters: it costs a while
        if twins.fits_one_of_alike:
            fails = self._failures(before, figures[0].features, T_nav_body @ aim.T_body_head)
        repeated = 1 - again + again * float(repeats.max(initial=0.0))
        lost = false * repeated
        stays = float(share @ lost**novelty)  # of the lost weight, beside what goes to each candidate
        factors: list[float] = []
        corrects: list[Correction | None] = []
        for i in range(len(before.hypotheses)):
            elsewhere = float(np.delete(repeats, i).max(initial=0.0))
            likelihood = (1 - false) * at[i] + false * (1 - again + again * elsewhere)
            fitting = twins.fitting[i]
            fresh = freshness if fitting is None else float(novelty[fitting])
            relative = twins.likelihood(i, float(likelihood), at, fails) / lost
            factors.append(stays * relative**fresh)
            best = int(np.argmax(density[i]))
            is_right = float((1 - false) * density[i][best] / likelihood)
            corrects.append(Correction(best, fits[i][best], is_right) if fits[i][best].squared < SAME_POSE else None)
        fails_in_map = failure_probability(c.fitted.fails_in_map, figures[0].features, 0.0)
        alike = twins.after(expected_by, fails_in_map)
        likeliest = int(np.argmax(share))
        strayed = self._rarer(candidates[likeliest], figures[likeliest]) if expected_by[likeliest] is None else false
        return ImageLikelihood(
            at=twins.levelled(factors, alike),
            lost=stays,
            unmapped=stays * (strayed / false) ** freshness,
            candidates=candidates,
            found=share * (1 - false**novelty),
            corrects=corrects,
            expected_by=expected_by,
            counted_log_odds=novelty * np.maximum(worth, 0.0),
            alike=alike,
        )

    def measured(self, z: Localization, aim: Aim = AHEAD) -> PoseMeasurement:
        """A verified pose of an image, as the filter takes it."""
        index = self._index[z.map_id]
        unit = self._maps[index].unit
        swung, swing_rad = swing(z, self._maps[index].place_map.navigation.landmarks)
        sigma_m = float(np.linalg.norm([z.sigma_position / unit, self.config.pose_floor_m, swung / unit]))
        camera = self._cameras[index]
        T_cam_body = np.eye(4) if camera is None else camera.T_cam_body_matrix
        T_head_body = inverse(aim.T_body_head)
        T_head_body[:3, 3] *= unit
        T_map_body = z.T_map_cam @ T_cam_body @ T_head_body
        sigma_rad = float(np.linalg.norm([self.config.pose_floor_rad, aim.sigma_rad, swing_rad]))
        return PoseMeasurement(z, index, unit, T_map_body, sigma_m, sigma_rad)

    def figures(self, m: PoseMeasurement) -> MatchFigures:
        """By which it is judged whether the pose is right."""
        z, view = m.localization, self._maps[m.map_index]
        camera, floor = self._cameras[m.map_index], self._floors[m.map_index]
        share = off_floor = None
        if camera is not None and view.sightings.is_enough:
            share = support(len(z.landmarks), view.sightings.in_view(z.T_map_cam, camera))
        if floor is not None:
            off_floor = floor.off(m.T_map_body, m.sigma_m * m.unit, m.sigma_rad)
        is_free = bool(view.space.knows(m.T_map_body[None, :3, 3])[0])
        return MatchFigures(z.extent / m.unit, z.num_inliers, share, z.num_features, off_floor, is_free)

    def _rarer(self, m: PoseMeasurement, figures: MatchFigures) -> float:
        """How much rarer an image whose best candidate has these is where no map knows than somewhere in a map.

        What looks alike there deceives as often as what looks alike in the map.
        """
        c = self.config
        log = log_odds(c.fitted.unmapped, figures) - self._own[m.map_index]
        return float(np.clip(np.exp(log), c.false_localization_floor, 1.0))

    def _fit(self, h: Hypothesis, m: PoseMeasurement, T_nav_body: FloatArray) -> Agreement:
        """How well a candidate fits a hypothesis, as it is or should wheels have slipped; in another map not at all.

        Height and tilt of a robot on a floor carry no choice, so the density counts x, y and heading.
        """
        if h.map_index != m.map_index:
            return Agreement(np.inf, 0.0)
        T_expected, T_measured = h.pose(T_nav_body), m.T_map_body
        gap_m = float(np.linalg.norm(T_measured[:3, 3] - T_expected[:3, 3])) / m.unit
        turn = float(np.linalg.norm(so3_log(T_expected[:3, :3].T @ T_measured[:3, :3])))
        sigma_rad = float(np.hypot(h.sigma_rad, m.sigma_rad))
        uniform = 1.0 / (max(self._maps[m.map_index].area_m2, 1.0) * 2 * np.pi)

        sigma_m = float(np.hypot(h.sigma_m, m.sigma_m))

        def against(slipped_m: float, slipped: bool) -> Agreement:
            """Anywhere within `slipped_m` of where odometry has it: farther no wheel that slips leaves a robot."""
            beyond_m = max(0.0, gap_m - slipped_m)
            squared = beyond_m**2 / sigma_m**2 + turn**2 / sigma_rad**2
            peak = 1.0 / ((2 * np.pi) ** 1.5 * (sigma_m**2 + slipped_m**2) * sigma_rad)
            tail = (1.0 + squared / FREEDOM) ** (-0.5 * (FREEDOM + 3.0))
            return Agreement(squared, max(peak / uniform, 1.0) * tail, slipped)

        slip = self.config.slip
        rolled, slipped = against(0.0, slipped=False), against(h.way_m, slipped=True)
        likelier = slipped if slip * slipped.density > (1 - slip) * rolled.density else rolled
        return replace(likelier, density=(1 - slip) * rolled.density + slip * slipped.density)

    def _novelty(
        self,
        candidates: Sequence[PoseMeasurement],
        together: Sequence[float],
        before: Belief,
        expecting: Sequence[Hypothesis | None],
        worth: FloatArray,
    ) -> FloatArray:
        """(C,) 0..1: the share of the landmarks that each recognises and no hypothesis did lately.

        While all that a hypothesis recognised is small enough for furniture that comes twice, the whole has a budget:
        what is as large as it is worth (`together`, log odds), of which the candidate may count what was not counted
        yet. `worth`: log odds of each by itself.
        """
        c = self.config
        surely = np.log(1 / c.false_localization_floor - 1)  # no look-alike is as large: images err one by one
        novelty = []
        for m, h, of_all, of_one in zip(candidates, expecting, together, worth, strict=True):
            z = m.localization
            # What any of them recognised is no news to this one: a look-alike's pose may scatter.
            new = max(self._recognised_before(before.hypotheses, m).share_of_new(z.landmarks), c.same_landmarks)
            had = NOTHING if h is None else self._recognised_before((h,), m)
            budget = max(0.0, of_all) - float(np.log(c.deceived_again))
            if h is not None and had.seen and of_one > 0 and budget < surely:
                new = min(new, max(0.0, budget - h.counted_log_odds) / of_one)
            novelty.append(new)
        return np.clip(novelty, 0.0, 1.0)

    def _odds_together(self, m: PoseMeasurement, figures: MatchFigures, h: Hypothesis | None) -> float:
        """Log odds of a candidate, were it as large as all that the hypothesis that expects it recognised with it."""
        z = m.localization
        had = NOTHING if h is None else self._recognised_before((h,), m)
        together = had.and_then(z.landmarks, z.t_robot_ns)
        p_map = self._maps[m.map_index].place_map.navigation.landmarks.p_world
        extent_m = together.extent(p_map, CELL_M * m.unit) / m.unit
        return self._log_odds(m, replace(figures, extent_m=extent_m))

    def _log_odds(self, m: PoseMeasurement, figures: MatchFigures) -> float:
        """That a pose with these figures is right."""
        return log_odds(self.config.fitted.right, figures) + self._own[m.map_index]

    def _recognised_before(self, hypotheses: Sequence[Hypothesis], m: PoseMeasurement) -> Recognised:
        """Landmarks of the candidate's map that these hypotheses recognised lately."""
        seen = NOTHING
        for h in hypotheses:
            if h.map_index == m.map_index:
                seen |= h.recognised
        return seen.lately(m.localization.t_robot_ns, self.config.memory_s)

    # -- an image that was not --------------------------------------------------------------------------------------

    def of_failure(
        self,
        num_features: int,
        failed_before: float,
        before: Belief,
        T_nav_body: FloatArray,
        freshness: float,
        aim: Aim = AHEAD,
    ) -> ImageLikelihood:
        """The likelihood of an image that was not recognised; `failed_before`: nor was the last one, 0 to 1."""
        c = self.config
        somewhere = failure_probability(c.fitted.fails_in_map, num_features, failed_before)
        failures = self._failures(before, num_features, T_nav_body @ aim.T_body_head, failed_before)
        factors = [at**freshness for at in failures]
        nowhere = failure_probability(c.fitted.fails_unmapped, num_features, failed_before)
        return ImageLikelihood(
            factors,
            somewhere**freshness,
            nowhere**freshness,
            corrects=(None,) * len(before.hypotheses),
            alike=[
                h.alike.and_failed(at / somewhere, freshness) for h, at in zip(before.hypotheses, failures, strict=True)
            ],
        )

    def _failures(
        self, before: Belief, num_features: int, T_nav_head: FloatArray, failed_before: float = 0.0
    ) -> list[float]:
        """(H,) that an image is not recognised, were each hypothesis true."""
        odds = self.config.fitted
        counts = [self._in_view(h, T_nav_head) for h in before.hypotheses]
        return [
            failure_probability(odds.fails_in_map, num_features, failed_before)
            if count is None
            else failure_probability(odds.fails_at_pose, num_features, failed_before, count)
            for count in counts
        ]

    def _in_view(self, h: Hypothesis, T_nav_head: FloatArray) -> float | None:
        """How many landmarks must be in view, were a hypothesis true (`surely_in_view`); None: nobody knows.

        Nobody does where the pose is uncertain by half of what a camera sees.
        """
        sightings = self._maps[h.map_index].sightings
        is_uncertain = h.sigma_rad + h.sigma_m / USUAL_VIEWING_M > self._half_view
        camera = self._cameras[h.map_index]
        if camera is None or is_uncertain or not sightings.is_enough:
            return None
        return sightings.surely_in_view(h.pose(T_nav_head) @ camera.T_body_cam_matrix, camera)


def swing(z: Localization, landmarks: Landmarks) -> tuple[float, float]:
    """How far a camera may be off around what it recognised, and by what angle: map units and rad, one sigma each.

    Landmarks of one thing were seen from the same places and err alike, so that however many there are, the thing may
    be tilted by one's error over its extent; and the camera is found turned about it by as much.
    """
    if not len(z.landmarks):
        return 0.0, 0.0
    variance = np.trace(landmarks.cov_world[z.landmarks], axis1=1, axis2=2) / 3.0
    far = np.linalg.norm(landmarks.p_world[z.landmarks] - z.T_map_cam[:3, 3], axis=1)
    angle = float(np.sqrt(np.median(variance))) / max(z.extent, 1e-9)
    return float(np.median(far)) * angle, angle


def _expected_by(fits: list[list[Agreement]], candidate: int) -> int | None:
    """The index of the hypothesis that a candidate fits best."""
    by = [i for i, row in enumerate(fits) if row[candidate].squared < SAME_POSE]
    return max(by, key=lambda i: fits[i][candidate].density) if by else None


# -- logistic regressions -----------------------------------------------------------------------------------------


def support(recognised: float, expected: float) -> float:
    """The share of what should be in view that was recognised, small counts drawn to what is not surprising.

    Both in landmarks (`Sightings.in_view`). More than all of it speaks no more for a pose: a look-alike's, from where
    nothing is known to be seen, recognises ten times what should be.
    """
    return min(1.0, (recognised + LITTLE) / (expected + LITTLE))


def terms(figures: MatchFigures) -> FloatArray:
    """(7,) what the coefficients of `RecognisedOdds` are multiplied with. Of figures without None (`or_usual`)."""
    if figures.support is None or figures.off_floor is None:
        raise ValueError("figures that nobody knows have no odds")
    return np.array([
        1.0,
        np.log(max(figures.extent_m, LEAST_EXTENT_M)),
        np.log1p(figures.inliers),
        np.log(figures.support),
        np.log1p(figures.features),
        np.log1p(figures.off_floor),
        figures.is_free,
    ])  # fmt: skip


def log_odds(odds: RecognisedOdds, figures: MatchFigures) -> float:
    """Log odds of a verified pose with these figures."""
    return float(np.dot(msgspec.structs.astuple(odds), terms(figures)))


def failure_probability(odds: FailureOdds, num_features: int, failed_before: float, in_view: float = 1.0) -> float:
    """That an image is not recognised; `in_view`: as `Sightings.in_view` counts."""
    log = odds.constant + odds.features * np.log1p(num_features)
    log += odds.again * failed_before + odds.in_view * np.log(in_view + LITTLE)
    return float(1.0 / (1.0 + np.exp(-log)))
