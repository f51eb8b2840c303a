"""What an answer to "which place is this?" costs as the map grows: 1, 10, 100, 1000 rooms.

    python -m benchmarks.bench_place_scale [--rooms 1 10 100 1000] [--answers 200] [--figure FILE.png] [--results FILE]

Stand-in: a few simulated furnished rooms, mapped with the simulator's poses and depths. Every room of the large map is
one of them, elsewhere, with its descriptors' 16 cells and 8 directions shuffled in a way of its own: statistics of real
images, and nothing to recognise in another copy. A second drive's images are shuffled likewise; its true motion stands
in for odometry between the images of one visit. One answer is decoding, features, proposal, pose and belief, in one
process (BLAS threads as the environment says). Truth judges the answers.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
import tracemalloc
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.result import Figure, Run, add_results_option, share
from benchmarks.true_map import map_truly
from robot.simulation.atlas import default_cache_dir
from robot.simulation.config import SimulationConfig
from robot.simulation.recording import simulated_calibration
from robot.simulation.renderer import Renderer
from robot.simulation.routes import plan_route
from robot.simulation.worlds import make_world
from shared.calibration import Calibration
from shared.geometry import FloatArray
from station.model.floor_plan import FREE, NO_ROOM, UNSEEN, FloorPlan
from station.model.floor_plan import Room as PlanRoom
from station.model.frames import ImageFrame
from station.model.navigation import Keyframes, Landmarks
from station.model.place_map import Place, PlaceMap
from station.places.localisation.keyframe_features import KeyframeFeatures, describe_keyframes
from station.places.localisation.localizer import Localizer
from station.places.tracking.current import CurrentPlaceEstimator
from station.vision.features import DescriptorArray, FeatureExtractor, Features, extract_encoded
from tests.support.drives.robot import START_NS, SimulatedRobot
from tests.support.drives.routes import Plan

BASE_ROOMS = 2
SPACING_M = 12.0  # between the copies
ROOM_M = 8.0  # of the square that is a copy's room
CELL_M = 0.2
KEYFRAMES_PER_ROOM = 16
VISIT = 12  # images of one room before the robot is put into another one
ANSWER_WITHIN_MS = 200.0  # asked at 95 %, with 1000 rooms too
TRACED = 5  # answers whose memory is traced: tracing makes them slow


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """One mapped room and the images of a second drive through it."""

    place_map: PlaceMap
    described: list[KeyframeFeatures]
    frames: list[ImageFrame]
    T_true: FloatArray  # (n, 4, 4) of the robot at each of the frames


def make_room(seed: int, calibration: Calibration) -> Room:
    """A simulated room, its map thinned to KEYFRAMES_PER_ROOM, and a second drive."""
    world = make_world("room", seed)
    assert calibration.camera is not None
    renderer = Renderer(world, calibration.camera, default_cache_dir())
    place_map = map_truly(renderer, calibration, seed)
    described = describe_keyframes(
        place_map, partial(extract_encoded, extractor=FeatureExtractor(up_deg=calibration.up_in_image_deg))
    )
    keyframes = place_map.navigation.keyframes
    kept = np.unique(np.linspace(0, len(keyframes) - 1, KEYFRAMES_PER_ROOM).round().astype(int))
    landmarks = place_map.navigation.landmarks
    still = np.isin(landmarks.observed_keyframe, kept)
    thinned = replace(
        place_map.navigation,
        landmarks=replace(
            landmarks,
            observed_landmark=landmarks.observed_landmark[still],
            observed_keyframe=np.searchsorted(kept, landmarks.observed_keyframe[still]),
            observed_uv_px=landmarks.observed_uv_px[still],
        ),
        keyframes=Keyframes(
            np.arange(len(kept)),
            keyframes.t_robot_ns[kept],
            keyframes.T_world_cam[kept],
            (b"",) * len(kept),
            keyframes.segment[kept],
        ),
    )
    plan = Plan("second", plan_route(world, "second", seed + 1), None, 60.0)
    robot = SimulatedRobot(renderer, calibration, SimulationConfig(), plan, seed + 1)
    frames: list[ImageFrame] = []
    poses: list[FloatArray] = []
    for item in robot.sent(2.0):
        if isinstance(item, ImageFrame):  # at once: the history forgets
            frames.append(item)
            T_world_body, _ = robot.true_at(item.t_robot_ns + round(1e9 * calibration.camera.time_shift_s))
            poses.append(T_world_body)
    return Room(
        place_map=replace(place_map, navigation=thinned),
        # Only features with a position: they are what is matched, and what the index is made from here.
        described=[replace(described[k], all_descriptors=described[k].descriptors) for k in kept],
        frames=frames,
        T_true=np.array(poses),
    )


def shuffled(descriptors: DescriptorArray, copy: int) -> DescriptorArray:
    """Descriptors (n, 128) as another scene of the same statistics has them; copy 0 is the scene itself."""
    if copy == 0:
        return descriptors
    rng = np.random.default_rng([copy, 11])
    cells, directions = rng.permutation(16), rng.permutation(8)
    order = (8 * cells[:, None] + directions[None]).ravel()
    return np.ascontiguousarray(descriptors[:, order])


def offset_of(copy: int) -> FloatArray:
    """Where a copy stands: a square of rooms, filled diagonal by diagonal."""
    row = int((np.sqrt(8 * copy + 1) - 1) / 2)
    column = copy - row * (row + 1) // 2
    return SPACING_M * np.array([row - column, column, 0.0])


def build_copies(rooms: list[Room], count: int) -> tuple[PlaceMap, list[KeyframeFeatures]]:
    """One map of `count` rooms, and its keyframes' features."""
    poses, points, covariances, places, described = [], [], [], [], []
    seen, seen_from, seen_at = [], [], []
    num_landmarks, num_keyframes = 0, 0
    for copy in range(count):
        room = rooms[copy % len(rooms)]
        navigation, offset = room.place_map.navigation, offset_of(copy)
        T = navigation.keyframes.T_world_cam.copy()
        T[:, :3, 3] += offset
        for features in room.described:
            mine = shuffled(features.descriptors, copy)
            described.append(KeyframeFeatures(mine, features.p_map + offset, features.landmark + num_landmarks, mine))
        places += [_moved(place, copy, offset, num_landmarks, num_keyframes) for place in room.place_map.places]
        poses.append(T)
        points.append(navigation.landmarks.p_world + offset)
        covariances.append(navigation.landmarks.cov_world)
        seen.append(navigation.landmarks.observed_landmark + num_landmarks)
        seen_from.append(navigation.landmarks.observed_keyframe + num_keyframes)
        seen_at.append(navigation.landmarks.observed_uv_px)
        num_landmarks += len(navigation.landmarks)
        num_keyframes += len(T)
    base = rooms[0].place_map
    t = np.arange(num_keyframes, dtype=np.int64)
    navigation = replace(
        base.navigation,
        id=f"{count} rooms",
        keyframes=Keyframes(t, t, np.concatenate(poses), (b"",) * num_keyframes, np.zeros_like(t)),
        landmarks=Landmarks(
            np.concatenate(points),
            np.zeros((num_landmarks, 3), np.uint8),
            np.concatenate(covariances),
            np.concatenate(seen),
            np.concatenate(seen_from),
            np.concatenate(seen_at),
        ),
    )
    place_map = PlaceMap(f"{count} rooms", "", navigation, tuple(places), (), base.config)
    return replace(place_map, plan=plan_of(place_map, count)), described


def plan_of(place_map: PlaceMap, count: int) -> FloorPlan:
    """A room around each copy, where all of its cameras stood."""
    eyes = place_map.navigation.keyframes.T_world_cam[:, :2, 3]
    low, high = eyes.min(axis=0) - SPACING_M, eyes.max(axis=0) + SPACING_M
    room = np.full(np.ceil((high - low) / CELL_M).astype(int), NO_ROOM, dtype=np.int16)
    middle = eyes[:KEYFRAMES_PER_ROOM].mean(axis=0)
    rooms = []
    for copy in range(count):
        at = middle + offset_of(copy)[:2]
        (x0, y0), (x1, y1) = (np.round((at + sign * ROOM_M / 2 - low) / CELL_M).astype(int) for sign in (-1, 1))
        room[x0:x1, y0:y1] = copy
        rooms.append(PlanRoom(room_id(copy), f"Room {copy + 1}", ROOM_M**2, at))
    return FloorPlan(
        R_ground_map=np.eye(3),
        low=low,
        cell=CELL_M,
        unit=1.0,
        state=np.where(room == NO_ROOM, UNSEEN, FREE).astype(np.uint8),
        room=room,
        rooms=tuple(rooms),
        doors=(),
        walls=np.zeros((0, 2, 2)),
        room_of_place={place.id: room_id(int(place.id.partition("/")[0])) for place in place_map.places},
    )


def room_id(copy: int) -> str:
    return f"room-{copy}"


def _moved(place: Place, copy: int, offset: FloatArray, first_landmark: int, first_keyframe: int) -> Place:
    return replace(
        place,
        id=f"{copy}/{place.id}",
        name=f"{place.name} of room {copy}",
        centroid_map=place.centroid_map + offset,
        landmark_index=place.landmark_index + first_landmark,
        keyframe_index=place.keyframe_index + first_keyframe,
        representative_keyframe=-1,
    )


def measure(rooms: list[Room], count: int, answers: int, calibration: Calibration) -> dict[str, Any]:
    """One map size: build the index, then answer images from random rooms of it."""
    place_map, described = build_copies(rooms, count)
    start = time.perf_counter()
    localizer = Localizer([place_map], described=[described])
    build_s = time.perf_counter() - start
    estimator = CurrentPlaceEstimator([place_map], calibration)
    centroids = np.array([place.centroid_map for place in place_map.places])
    rng = np.random.default_rng(count)
    asked = Asked(localizer, estimator, calibration, FeatureExtractor(up_deg=calibration.up_in_image_deg))
    wall, cpu, index_ms, states, named, recognised = [], [], [], [], [], []
    t_ns = START_NS
    for visit in range(max(1, answers // VISIT)):
        copy = int(rng.integers(count))
        room = rooms[copy % len(rooms)]
        first = int(rng.integers(max(1, len(room.frames) - VISIT)))
        estimator.on_hijack(t_ns, "put into another room")
        for k in range(first, min(first + VISIT, len(room.frames))):
            t_ns += 500_000_000
            estimator.on_odometry(t_ns, room.T_true[k], segment=visit)
            begin, begin_cpu = time.perf_counter(), time.process_time()
            features, is_recognised, answer = asked.answer(room.frames[k], copy, t_ns)
            wall.append(time.perf_counter() - begin)
            cpu.append(time.process_time() - begin_cpu)
            begin = time.perf_counter()
            localizer.appearances[0].query(features.descriptors, localizer.config.num_proposals)
            index_ms.append(1e3 * (time.perf_counter() - begin))
            distance = np.linalg.norm(centroids - (room.T_true[k, :3, 3] + offset_of(copy)), axis=1)
            right = {place_map.places[i].id for i in np.flatnonzero(distance <= 1.1 * distance.min())}
            states.append((answer.state, answer.place is not None and answer.place.id in right))
            if answer.room is not None:
                named.append(answer.room.id == room_id(copy))
            recognised.append(is_recognised)
    tracemalloc.start()
    for k in range(TRACED):
        t_ns += 500_000_000
        asked.answer(rooms[0].frames[k], 0, t_ns)
    answer_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    known = [right for state, right in states if state == "known"]
    return {
        "rooms": count,
        "keyframes": len(described),
        "descriptors": sum(len(d.descriptors) for d in described),
        "places": len(place_map.places),
        "words": localizer.appearances[0].num_words,
        "build_s": build_s,
        "index_mb": localizer.appearances[0].num_bytes / 1e6,
        "features_mb": sum(d.descriptors.nbytes + d.p_map.nbytes + d.landmark.nbytes for d in described) / 1e6,
        "answer_peak_mb": answer_bytes / 1e6,
        "answers": len(wall),
        "wall_ms_median": 1e3 * float(np.median(wall)),
        "wall_ms_p95": 1e3 * float(np.percentile(wall, 95)),
        "cpu_ms_median": 1e3 * float(np.median(cpu)),
        "cpu_ms_p95": 1e3 * float(np.percentile(cpu, 95)),
        "index_ms_median": float(np.median(index_ms)),
        "recognised": int(np.sum(recognised)),
        "unknown": sum(state == "unknown" for state, _ in states),
        "known": len(known),
        "known_right": int(np.sum(known)),
        "room_named": len(named),
        "room_right": int(np.sum(named)),
    }


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Everything that answers."""

    localizer: Localizer
    estimator: CurrentPlaceEstimator
    calibration: Calibration
    extractor: FeatureExtractor

    def answer(self, frame: ImageFrame, copy: int, t_ns: int) -> tuple[Features, bool, Any]:
        """Of one image taken in a copy of its room: its features there, whether it was recognised, the answer."""
        assert self.calibration.camera is not None
        seen = self.extractor.extract(frame.grey())
        features = Features(seen.uv_px, shuffled(seen.descriptors, copy))
        attempt = self.localizer.attempt_features([features], t_ns, self.calibration.camera)
        if attempt.candidates:
            self.estimator.on_candidates(attempt.candidates, t_ns)
        else:
            self.estimator.on_failure(t_ns, attempt.num_features)
        return features, bool(attempt.candidates), self.estimator.answer(t_ns)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Time and memory against rooms, with what linear growth would be."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    rooms = np.array([row["rooms"] for row in rows], dtype=float)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for key, label in (
        ("cpu_ms_median", "CPU, median"),
        ("cpu_ms_p95", "CPU, 95 %"),
        ("index_ms_median", "index only"),
    ):
        left.loglog(rooms, [row[key] for row in rows], "o-", label=label)
    left.loglog(rooms, rows[0]["cpu_ms_median"] * rooms, ":", color="grey", label="linear")
    left.axhline(ANSWER_WITHIN_MS, color="red", linewidth=0.8, label="bound")
    left.set(xlabel="rooms in the map", ylabel="ms per answer", ylim=(1, 2000))
    left.legend(fontsize=8)
    for key, label in (("features_mb", "keyframes' features"), ("index_mb", "index"), ("answer_peak_mb", "one answer")):
        right.loglog(rooms, [row[key] for row in rows], "o-", label=label)
    right.set(xlabel="rooms in the map", ylabel="MB")
    right.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="*", type=int, default=[1, 10, 100, 1000])
    parser.add_argument("--answers", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first simulated room")
    parser.add_argument("--figure", type=Path, default=None)
    add_results_option(parser, "place_scale")
    a = parser.parse_args()
    run = Run.begin()
    cv2.setNumThreads(1)
    calibration = simulated_calibration(SimulationConfig())
    rooms = [make_room(a.seed + k, calibration) for k in range(BASE_ROOMS)]
    rows = []
    for count in a.rooms:
        rows.append(measure(rooms, count, a.answers, calibration))
        print(json.dumps(rows[-1]), flush=True)
        gc.collect()
    if a.figure:
        draw(rows, a.figure)
    run.write(a.results, figures(rows))


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """What an answer costs in each map, and whether it is right."""
    answers = [
        Figure(
            f"rooms in the map: {row['rooms']}; wall time of an answer, 95 %",
            row["wall_ms_p95"], "ms", ANSWER_WITHIN_MS, of=row["answers"],
        )
        for row in rows
    ]  # fmt: skip
    right, known, room_right, named = (
        sum(row[key] for row in rows) for key in ("known_right", "known", "room_right", "room_named")
    )
    return [
        *answers,
        share("known answers that are right, in maps of every size", right, known),
        share("named rooms that are right, in maps of every size", room_right, named),
    ]


if __name__ == "__main__":
    main()
