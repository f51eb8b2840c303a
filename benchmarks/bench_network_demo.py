"""The demo with robot and station at the two ends of an emulated network: what SLAM and the current place make of it.

    python -m benchmarks.bench_network_demo [--profiles "two walls"] [--seeds 1-10] [--results FILE]

The programs are paired and speak by TLS, as in bench_network, and each flat takes three minutes in real time. What each
came to is a line of a file; started again with the same code it goes on where it ended. Needs root.
"""

from __future__ import annotations

import argparse
import contextlib
import socket
import socketserver
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.bench_mapping import parse_seeds
from benchmarks.result import (
    Figure,
    Run,
    add_results_option,
    end_as_by_ctrl_c,
    failed_seeds,
    rows_by_seed,
    share,
    work_folder,
)
from shared.errors import RobotSystemError
from station.demo.demo import START_TIMEOUT_S, Demo, DemoOptions, Timings, describe, map_hijack_and_ask, wait_for
from station.demo.folder import fresh_folder
from station.demo.processes import Programs
from station.demo.simulator_client import SimulatorClient
from station.demo.station_client import StationClient
from station.files.navigation_folder import load_navigation
from tests.support.network.conditions import PROFILES
from tests.support.network.emulator import Namespace, Network, missing_reason
from tests.support.network.programs import PAGE_PORT, SIM_PORT, Ends

WORLD = "small"  # the demo's own
PASSED_PERCENT = {"busy 2.4 GHz": 100.0, "two walls": 80.0}  # asked


@contextmanager
def back_door(robot: Namespace) -> Iterator[None]:
    """The simulator's control port, which only its own loopback knows, on ours too: judges do not use the network."""

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            with robot.entered():
                far = socket.create_connection(("127.0.0.1", SIM_PORT))
            # The driver is ended in the middle of a question when the second drive is over.
            with far, far.makefile("rwb") as lines, contextlib.suppress(ConnectionError):
                for question in self.rfile:
                    lines.write(question)
                    lines.flush()
                    self.wfile.write(lines.readline())

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Server(("127.0.0.1", SIM_PORT), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()
            thread.join()


def run_demo(name: str, seed: int) -> dict[str, Any]:
    """What came of one flat; a demo that came to no end has not passed."""
    row: dict[str, Any] = {"network": name, "seed": seed, "passed": False}
    with (
        tempfile.TemporaryDirectory(prefix="network-demo-") as folder,
        Network(PROFILES[name], seed) as network,
        network.station.entered(),
    ):
        out = Path(folder)
        options = DemoOptions(seed, once=True, port=PAGE_PORT, world=WORLD, backend=None, out=out)
        try:
            with Programs(out / "logs") as programs, back_door(network.robot):
                return row | judged(start(network, options, programs))
        except RobotSystemError as exc:
            return row | {"said": str(exc)}


def start(network: Network, options: DemoOptions, programs: Programs) -> Demo:
    """As the demo starts them, but apart, paired and by TLS."""
    data = fresh_folder(options.out)
    ends = Ends.paired(network, options.out, data, options.world, options.seed)
    with network.robot.entered():
        programs.start("robot-server", "robot.main", "--devices", "simulated", "--config", str(ends.robot_config))
    serve = ("serve", "--robot", ends.robot_address, "--port", str(options.port), "--data", str(data))
    programs.start("station", "station.main", *serve)
    station = StationClient(f"http://127.0.0.1:{options.port}")
    wait_for(programs, "the station", station.is_up, START_TIMEOUT_S)
    wait_for(programs, "the robot", lambda: station.get("/robot")["rates"]["frames_hz"] > 0, START_TIMEOUT_S)
    return Demo(options, programs, station, SimulatorClient(SIM_PORT), SIM_PORT, lambda text: print(text, flush=True))


def judged(demo: Demo) -> dict[str, Any]:
    """Map, hijack, second drive, and the truth's verdict on them."""
    data = demo.options.out / "data"
    try:
        outcome = map_hijack_and_ask(demo, data, Timings())
    finally:
        demo.simulator.close()
    verdict = outcome.verdict
    first = next(n["id"] for n in demo.station.get("/navigations") if n["name"] == "Navigation1")
    navigation = load_navigation(data / "navigations" / first / "navigation")
    return {
        "passed": verdict.passed,
        "said": describe(verdict),
        "right": verdict.right,
        "wrong": verdict.wrong,
        "not_known": verdict.not_known,
        "map_error_m": verdict.map_error_m,
        "slam_lost_s": navigation.report.tracking_lost_s,
    }


def figures(name: str, rows: Sequence[dict[str, Any]]) -> Iterator[Figure]:
    """Over all flats of one network."""
    mapped = [row for row in rows if "map_error_m" in row]
    right, wrong, not_known = (sum(row[key] for row in mapped) for key in ("right", "wrong", "not_known"))
    lost_s = max((row["slam_lost_s"] for row in mapped), default=None)
    error_m = max((row["map_error_m"] for row in mapped), default=None)
    passed, why = sum(row["passed"] for row in rows), failed_seeds(list(rows), why_not)
    yield share(f"{name}: demo: flats that passed", passed, len(rows), at_least=PASSED_PERCENT.get(name), note=why)
    yield Figure(f"{name}: demo: SLAM lost in the mapping drive, longest", lost_s, "s", of=len(mapped))
    yield Figure(f"{name}: demo: ATE of the mapping drive, worst", error_m, "m", of=len(mapped))
    yield share(f"{name}: demo: answers known and right", right, right + wrong + not_known)
    yield share(f"{name}: demo: known answers that are right", right, right + wrong)


def why_not(row: dict[str, Any]) -> str:
    """The end of what the judge says, or how the demo ended."""
    return str(row["said"]).rpartition(": FAILED: ")[2]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=list(PASSED_PERCENT))
    parser.add_argument("--seeds", default="1-10")
    add_results_option(parser, "network_demo")
    options = parser.parse_args()
    run = Run.begin()
    end_as_by_ctrl_c()  # its programs would stay
    if (reason := missing_reason()) is not None:
        print(f"bench_network_demo: {reason}", file=sys.stderr)
        return 1
    found: list[Figure] = []
    for name in options.profiles:
        kept = work_folder() / f"network_demo_{name}.jsonl"
        found += figures(name, rows_by_seed(kept, parse_seeds(options.seeds), partial(run_demo, name)))
        run.write(options.results, found)  # what there is: an hour may end early
    return 0


if __name__ == "__main__":
    sys.exit(main())
