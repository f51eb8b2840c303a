"""How well `station calibrate camera` does on real images and boards: numbers, honesty of the sigmas, time.

    python -m benchmarks.bench_calibrate_camera --halves 20

EuRoC's AprilGrid, OpenCV's chessboard (left and right camera, each by itself), and the corners of the reference robot's
136 boards; each set is also cut into random halves, whose numbers should lie within three of their own sigmas of each
other. Last, the command as a person starts it, on the 60 images of a simulated session.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_mapping import run_program
from benchmarks.result import Figure, Run, add_results_option, share
from shared.geometry import FloatArray
from station.calibration.boards import make_finder, view_board
from station.calibration.bundle import covariance, fit_camera, stack_views
from station.calibration.camera import calibrate_camera
from station.calibration.camera_verdict import reasons_against
from station.calibration.target import BoardView, Target
from station.calibration.target_file import read_target

LENS_COUNT = 8  # numbers of a radial-tangential camera
MOST_S = 10.0  # for a person who waits


@dataclass(frozen=True, slots=True, eq=False)
class BoardSet:
    """Views of one board by one camera, and what others found that camera to be."""

    name: str
    target: Target
    views: list[BoardView]
    size: tuple[int, int]
    published: FloatArray  # (4,) fx fy cx cy
    focal_bound: float | None = None  # %
    centre_bound: float | None = None  # px
    ms_per_image: float | None = None  # of CPU, to find the board


def find_all(
    name: str,
    target: Target,
    paths: list[Path],
    published: list[float],
    focal_bound: float | None = None,
    centre_bound: float | None = None,
) -> BoardSet:
    """The views in image files, and how long it took to find them."""
    finder = make_finder(target)
    images = [np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8) for path in paths]
    finder.find(images[0])  # what is set up once
    begin = time.process_time()
    seen = [view_board(finder, target, image, path.name, 0) for image, path in zip(images, paths, strict=True)]
    ms = 1e3 * (time.process_time() - begin) / len(paths)
    size = (images[0].shape[1], images[0].shape[0])
    views = [view for view in seen if view is not None]
    return BoardSet(name, target, views, size, np.array(published), focal_bound, centre_bound, ms)


def reference_boards(path: Path) -> BoardSet:
    """The boards that MATLAB found, which counts pixels from 1."""
    content = np.load(path)
    across, down = np.rint(content["world_points_mm"].T / 35.5).astype(int)
    target = Target("chessboard", int(across.max()) + 1, int(down.max()) + 1, 0.0355)
    ids = down * target.columns + across
    views = [BoardView(str(i), i, ids, corners - 1.0) for i, corners in enumerate(content["image_points"])]
    K = content["K"]
    published = np.array([K[0, 0], K[1, 1], K[0, 2] - 1.0, K[1, 2] - 1.0])
    return BoardSet("reference robot", target, views, (640, 480), published, 0.3)


def board_sets(data: Path) -> list[BoardSet]:
    """Every real set."""
    grid, chess = data / "aprilgrid_euroc", data / "opencv_chessboard"
    board = Target("chessboard", 9, 6, 0.025)
    euroc = [458.654, 457.296, 367.215, 248.375]
    left = [535.916, 535.916, 342.283, 235.571]
    right = [534.803, 534.803, 334.557, 242.053]  # of both cameras together, with one focal length: no bound
    return [
        find_all("EuRoC AprilGrid", read_target(grid / "target.yaml"), sorted(grid.glob("*.jpg")), euroc, 0.35, 2.5),
        find_all("OpenCV chessboard", board, sorted(chess.glob("left*.jpg")), left, 1.0),
        find_all("OpenCV chessboard, right", board, sorted(chess.glob("right*.jpg")), right),
        reference_boards(data / "reference_robot_calibration" / "calib_640_v2_decoded.npz"),
    ]


def agreement(boards: BoardSet, halves: int, rng: np.random.Generator) -> int:
    """How many numbers of random halves lie within three of their own sigmas, of halves * LENS_COUNT."""
    agree = 0
    for _ in range(halves):
        order = rng.permutation(len(boards.views))
        found = []
        for half in (order[: len(order) // 2], order[len(order) // 2 :]):
            corners = stack_views(boards.target, [boards.views[i] for i in half])
            fit = fit_camera(corners, "radtan", boards.size)
            found.append((fit.numbers, np.diag(covariance(corners, fit))))
        (a, var_a), (b, var_b) = found
        agree += int((np.abs(a - b) < 3.0 * np.sqrt(var_a + var_b)).sum())
    return agree


def measure(boards: BoardSet, halves: int, rng: np.random.Generator) -> list[Figure]:
    """One set's figures; a row of JSON on stdout."""
    begin = time.process_time()
    found, rejected = calibrate_camera(boards.target, boards.views, boards.size)
    seconds = time.process_time() - begin
    if found is None:
        return [Figure(f"{boards.name}: images used", 0, at_least=1)]
    numbers = found.fit.numbers
    reasons = reasons_against(found)
    print(json.dumps({
        "set": boards.name, "lens": found.fit.lens, "numbers": numbers.round(5).tolist(),
        "sigma": found.sigma.round(5).tolist(), "rms_px": round(found.rms_px, 4), "coverage": found.coverage,
        "used": len(found.views), "rejected": [item.reason for item in rejected], "reasons": reasons,
    }), flush=True)  # fmt: skip
    focal = 100 * float(np.max(np.abs(numbers[:2] / boards.published[:2] - 1.0)))
    centre = float(np.max(np.abs(numbers[2:4] - boards.published[2:])))
    figures = [
        Figure(f"{boards.name}: focal length off the published one", focal, "%", at_most=boards.focal_bound),
        Figure(f"{boards.name}: centre off the published one", centre, "px", at_most=boards.centre_bound),
        Figure(f"{boards.name}: left over", found.rms_px, "px", at_most=0.29),
        share(f"{boards.name}: accepted", not reasons, 1, at_least=100),
        share(
            f"{boards.name}: numbers of halves within three sigmas",
            agreement(boards, halves, rng), halves * LENS_COUNT, at_least=95,
        ),
        Figure(f"{boards.name}: CPU time of fit and judgement", seconds, "s"),
    ]  # fmt: skip
    if boards.ms_per_image is not None:
        bound = 30.0 if boards.target.kind == "aprilgrid" else None
        figures.append(Figure(f"{boards.name}: CPU time to find the board", boards.ms_per_image, "ms", at_most=bound))
    return figures


def command_figures(seed: int) -> list[Figure]:
    """How long somebody waits for `station calibrate camera`, and which part of that is processor time."""
    with tempfile.TemporaryDirectory() as name:
        session, out = Path(name) / "session", Path(name) / "camera.yaml"
        run_program("calibration", "--kind", "camera", "--seed", str(seed), "--out", str(session))
        images = len(list((session / "mav0" / "cam0" / "data").iterdir()))
        words = ["calibrate", "camera", session, "--target", session / "target.yaml", "--out", out]
        begin, begin_cpu = time.monotonic(), children_cpu_s()
        subprocess.run([sys.executable, "-m", "station.main", *map(str, words)], check=True, stdout=subprocess.DEVNULL)
        waited, cpu = time.monotonic() - begin, children_cpu_s() - begin_cpu
    title = f"station calibrate camera, {images} images"
    return [Figure(f"{title}: on the clock", waited, "s", at_most=MOST_S), Figure(f"{title}: CPU", cpu, "s")]


def children_cpu_s() -> float:
    """Of the programs that were started and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real recordings")
    parser.add_argument("--halves", type=int, default=20, help="random cuts of each set")
    parser.add_argument("--seed", type=int, default=0)
    add_results_option(parser, "calibrate_camera")
    args = parser.parse_args()
    run = Run.begin()
    cv2.setNumThreads(1)
    rng = np.random.default_rng(args.seed)
    figures = [figure for boards in board_sets(args.data) for figure in measure(boards, args.halves, rng)]
    run.write(args.results, [*figures, *command_figures(args.seed)])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
