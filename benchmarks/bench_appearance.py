"""The thesis' table 2.1, measured: what global descriptors, local features, words and both cost and tell.

    python -m benchmarks.bench_appearance [--step 2] [--data ../shared/data] [--results FILE]

Each scheme looks for the map's image that shows what a query shows. Two real recordings: the kitchen (one pass is the
map, another asks) and the V1_01 flight (every second keyframe is the map, the others ask). An answer is right where the
two true cameras stand within 1 m and look within 30 degrees of each other; only queries that have such an image count.
Images of the other building show how often a scheme takes a strange place for a known one.
- global: GIST, 512 numbers for an image, compared with every image of the map.
- local: the features of station/vision, matched both ways with every image of the map.
- words: station/vision's inverted file of visual words.
- combined: the ten best by words, then local features. That is how the station localises an image.
"""

from __future__ import annotations

import argparse
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.result import Figure, Run, add_results_option, share
from shared.geometry import FloatArray, rotation_angle
from station.datasets import open_dataset
from station.experiments.matches import truth_at
from station.model.frames import ImageArray, ImageFrame
from station.vision.appearance import AppearanceIndex
from station.vision.features import FeatureExtractor, Features, Float32Array, similarities
from station.vision.matching import match_both_ways
from tests.support.gist import GistDescriptor

RIGHT_M, RIGHT_RAD = 1.0, np.radians(30.0)
MAX_RATIO = 0.8  # Lowe, IJCV 60(2), 2004
SHORTLIST = 10
NEVER = -1.0  # score of an image that was not even looked at


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Grey images and where each was taken."""

    grey: tuple[ImageArray, ...]
    T_world_cam: FloatArray  # (n, 4, 4)

    def part(self, rows: slice) -> Pictures:
        return Pictures(self.grey[rows], self.T_world_cam[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A map to look into, who asks, and who should find nothing."""

    title: str
    mapped: Pictures
    queries: Pictures
    strange: tuple[ImageArray, ...]

    def right_answers(self) -> list[set[int]]:
        """For each query the images of the map that show the same."""
        a, b = self.queries.T_world_cam, self.mapped.T_world_cam
        distance = np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=2)
        turned = rotation_angle(np.swapaxes(a[:, None, :3, :3], -1, -2) @ b[None, :, :3, :3])
        right = (distance <= RIGHT_M) & (turned <= RIGHT_RAD)
        return [set(np.flatnonzero(row).tolist()) for row in right]


class Scheme(ABC):
    """One way to describe images and to find the likest one of a map."""

    name: str

    @abstractmethod
    def describe(self, grey: ImageArray) -> Any:
        """What a query is asked with."""

    @abstractmethod
    def index(self, described: Sequence[Any]) -> None:
        """Take in the map's images."""

    @abstractmethod
    def scores(self, described: Any) -> FloatArray:
        """(n,) how alike each image of the map is; NEVER where it was not looked at."""

    @property
    @abstractmethod
    def num_bytes(self) -> int:
        """What is kept of the map."""


class GlobalScheme(Scheme):
    name = "global"

    def __init__(self) -> None:
        self._gist = GistDescriptor()
        self._mapped: Float32Array = np.zeros((0, 512), np.float32)

    def describe(self, grey: ImageArray) -> Float32Array:
        return self._gist.describe(grey)

    def index(self, described: Sequence[Float32Array]) -> None:
        self._mapped = np.stack(described)

    def scores(self, described: Float32Array) -> FloatArray:
        return (self._mapped @ described).astype(np.float64)

    @property
    def num_bytes(self) -> int:
        return self._mapped.nbytes


class LocalScheme(Scheme):
    name = "local"

    def __init__(self) -> None:
        self._extractor = FeatureExtractor()
        self._mapped: list[Features] = []

    def describe(self, grey: ImageArray) -> Features:
        return self._extractor.extract(grey)

    def index(self, described: Sequence[Features]) -> None:
        self._mapped = list(described)

    def scores(self, described: Features) -> FloatArray:
        return self.scores_of(described, range(len(self._mapped)))

    def scores_of(self, described: Features, images: Sequence[int]) -> FloatArray:
        """Matches with some images of the map; the others were not looked at."""
        out = np.full(len(self._mapped), NEVER)
        for k in images:
            out[k] = len(match_both_ways(similarities(described, self._mapped[k]), MAX_RATIO))
        return out

    @property
    def num_bytes(self) -> int:
        return sum(f.descriptors.nbytes + f.uv_px.astype(np.float32).nbytes for f in self._mapped)


class WordScheme(Scheme):
    name = "words"

    def __init__(self) -> None:
        self._extractor = FeatureExtractor()
        self._words = AppearanceIndex(())

    def describe(self, grey: ImageArray) -> Features:
        return self._extractor.extract(grey)

    def index(self, described: Sequence[Features]) -> None:
        self._words = AppearanceIndex([features.descriptors for features in described])

    def scores(self, described: Features) -> FloatArray:
        out = np.full(self._words.num_images, NEVER)
        image, score = self._words.query(described.descriptors, self._words.num_images)
        out[image] = score
        return out

    @property
    def num_bytes(self) -> int:
        return self._words.num_bytes


class CombinedScheme(Scheme):
    name = "combined"

    def __init__(self) -> None:
        self._words, self._local = WordScheme(), LocalScheme()

    def describe(self, grey: ImageArray) -> Features:
        return self._local.describe(grey)

    def index(self, described: Sequence[Features]) -> None:
        self._words.index(described)
        self._local.index(described)

    def scores(self, described: Features) -> FloatArray:
        likely = np.argsort(-self._words.scores(described), kind="stable")[:SHORTLIST]
        return self._local.scores_of(described, likely.tolist())

    @property
    def num_bytes(self) -> int:
        return self._words.num_bytes + self._local.num_bytes


SCHEMES: tuple[Callable[[], Scheme], ...] = (GlobalScheme, LocalScheme, WordScheme, CombinedScheme)


@dataclass(frozen=True, slots=True)
class Measured:
    """What one scheme did on one task."""

    describe_ms: float  # CPU, median over images
    match_ms: float  # CPU, median over queries
    bytes_per_image: float
    right: int  # queries whose likest image is a right one
    asked: int  # queries that have a right one
    apart: float  # probability that a query from here scores higher than an image of another building


def measure(scheme: Scheme, task: Task) -> Measured:
    """Describe, index, ask."""
    described, seconds = _timed(scheme.describe, [*task.mapped.grey, *task.queries.grey, *task.strange])
    first, last = len(task.mapped.grey), len(task.mapped.grey) + len(task.queries.grey)
    scheme.index(described[:first])
    here, match_s = _timed(scheme.scores, described[first:last])
    there, _ = _timed(scheme.scores, described[last:])
    answers = task.right_answers()
    asked = [k for k, right in enumerate(answers) if right]
    right = sum(int(here[k].argmax()) in answers[k] for k in asked)
    best_here, best_there = np.array([here[k].max() for k in asked]), np.array([s.max() for s in there])
    return Measured(
        describe_ms=1e3 * float(np.median(seconds)),
        match_ms=1e3 * float(np.median(match_s)),
        bytes_per_image=scheme.num_bytes / first,
        right=right,
        asked=len(asked),
        apart=probability_of_more(best_here, best_there),
    )


def probability_of_more(a: FloatArray, b: FloatArray) -> float:
    """That one of a is larger than one of b, ties counted half: the area under the ROC curve."""
    larger = (a[:, None] > b[None]).mean()
    return float(larger + 0.5 * (a[:, None] == b[None]).mean())


def _timed(function: Callable[[Any], Any], arguments: Sequence[Any]) -> tuple[list[Any], list[float]]:
    """The results, and the CPU seconds of each call."""
    results, seconds = [], []
    for argument in arguments:
        start = time.process_time()
        results.append(function(argument))
        seconds.append(time.process_time() - start)
    return results, seconds


def figures(task: Task, name: str, found: Measured) -> list[Figure]:
    title = f"{task.title}, {name}"
    return [
        Figure(f"{title}: CPU to describe an image, median", found.describe_ms, "ms"),
        Figure(f"{title}: CPU to ask {len(task.mapped.grey)} images, median", found.match_ms, "ms"),
        Figure(f"{title}: storage for an image", found.bytes_per_image / 1e3, "kB"),
        share(f"{title}: likest image shows the same", found.right, found.asked),
        Figure(f"{title}: told apart from another building", 100 * found.apart, "%", of=found.asked),
    ]


def read_pictures(path: Path, first: int | None = None, last: int | None = None, step: int = 1) -> Pictures:
    """The images of a dataset that have a true pose."""
    data = open_dataset(path, first, last, step)
    assert data.truth is not None and data.read_frames is not None
    frames: list[ImageFrame] = list(data.read_frames())
    T = truth_at(data.truth, np.array([frame.t_robot_ns for frame in frames]))
    if data.calibration.camera is not None:
        T = T @ data.calibration.camera.T_body_cam_matrix
    known = np.flatnonzero(np.isfinite(T[:, 0, 0]))
    return Pictures(tuple(frames[k].grey() for k in known), T[known])


def make_tasks(data: Path, step: int) -> list[Task]:
    """Both recordings; `step`: every so manieth of the kitchen's frames."""
    kitchen = data / "redkitchen"
    mapped, queries = read_pictures(kitchen, 0, 398, step), read_pictures(kitchen, 500, 698, step)
    flight = read_pictures(data / "euroc_v1_01_keyframes")
    return [
        Task("kitchen", mapped, queries, flight.grey),
        Task("V1_01", flight.part(slice(0, None, 2)), flight.part(slice(1, None, 2)), queries.grey),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step", type=int, default=2)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    add_results_option(parser, "appearance")
    a = parser.parse_args()
    run = Run.begin()
    found: list[Figure] = []
    for task in make_tasks(a.data, a.step):
        for make in SCHEMES:
            scheme = make()
            rows = figures(task, scheme.name, measure(scheme, task))
            found += rows
            print(*(f"{row.what}: {row.value:.4g} {row.unit}" for row in rows), sep="\n", flush=True)
    run.write(a.results, found)


if __name__ == "__main__":
    main()
