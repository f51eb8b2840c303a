"""The demo on one page: start the programs, map, hijack, drive again, ask for the place, judge by the truth."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shared.disk import replace_file
from shared.errors import RobotSystemError
from shared.geometry import FloatArray
from station.demo.folder import alone_in, fresh_folder, require_free
from station.demo.judge import Sample, TrueRoom, Verdict, judge
from station.demo.processes import Programs, free_port
from station.demo.simulator_client import SimulatorClient
from station.demo.station_client import StationClient
from station.files.navigation_folder import load_navigation
from station.model.navigation import Trajectory
from station.model.place_answer import where
from station.model.place_map import PlaceGrain

START_TIMEOUT_S = 90.0  # the first start of a flat bakes its textures
DRIVE_TIMEOUT_S = 240.0
SLAM_TIMEOUT_S = 600.0  # without any progress; its last step tells of none, and a busy computer may take minutes
MAP_TIMEOUT_S = 300.0
TOO_MANY_LEFT_OUT = 0.25  # of the pictures: SLAM needs 15 of the robot's 20 a second
SECOND_DRIVE_S = 20.0  # Navigation2 lasts this long after the robot was put down
ASK_EVERY_S = 0.5
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What the command line chooses."""

    seed: int
    once: bool
    port: int
    world: str
    backend: str | None
    out: Path
    places: PlaceGrain = "rooms"


@dataclass(slots=True)
class Timings:
    """Wall seconds of each step."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        begin = time.monotonic()
        yield
        self.seconds[name] = round(time.monotonic() - begin, 1)


@dataclass(frozen=True, slots=True)
class Demo:
    """Everything the steps share."""

    options: DemoOptions
    programs: Programs
    station: StationClient
    simulator: SimulatorClient
    sim_port: int
    say: Say


def run_demo(options: DemoOptions, say: Say) -> bool:
    """Run the demo; True when the current place was answered correctly. Without `once` it then serves until Ctrl-C."""
    require_free(options.port)
    with alone_in(options.out):
        return run_in(options, fresh_folder(options.out), say)


def run_in(options: DemoOptions, data: Path, say: Say) -> bool:
    """Run the demo in its folder; a failure is said in `results.json` too, beside the verdict where there is one."""
    try:
        with Programs(options.out / "logs") as programs:
            return run_steps(options, programs, data, say)
    except RobotSystemError as exc:
        results = options.out / "results.json"
        so_far = json.loads(results.read_text()) if results.exists() else {"passed": False, "seed": options.seed}
        write_json(results, so_far | {"error": str(exc)})
        raise


LIKELY = 0.5  # more than that: two stickers that speak against each other have half each at most


def run_steps(options: DemoOptions, programs: Programs, data: Path, say: Say) -> bool:
    """The demo's main path."""
    timings = Timings()
    with timings.step("start"):
        demo = start_programs(options, programs, data, say)
    try:
        outcome = map_hijack_and_ask(demo, data, timings)
        write_results(options, outcome.verdict, timings, outcome.places)
        demo.station.call("POST", f"/navigations/{outcome.navigation2}/stop")
        say(describe(outcome.verdict))
        say(f"recordings, map and results: {data}, {options.out / 'results.json'}")
        if options.once:
            finish(demo, outcome.navigation2)
        else:
            serve_until_interrupted(demo)
    finally:
        demo.simulator.close()
    return outcome.verdict.passed


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a mapping drive, a hijack and a second drive."""

    verdict: Verdict
    places: list[dict[str, Any]]  # as GET /places gives them
    map_trajectory: Trajectory  # body poses of the mapping drive, map frame
    navigation2: str  # id; it is still being recorded


def map_hijack_and_ask(demo: Demo, data: Path, timings: Timings) -> Outcome:
    """Map the flat, put the robot down elsewhere, drive again, ask for the place; judged by the simulator's truth."""
    with timings.step("navigation1"):
        navigation1 = record_mapping(demo, "Navigation1")
    with timings.step("slam"):
        wait_for_slam(demo, "Navigation1", navigation1, is_for_map=True)
    with timings.step("map"):
        places = build_map(demo, navigation1)
    with timings.step("localisation"):
        wait_for_localisation(demo)
    with timings.step("navigation2"):
        put_down_ns, samples, navigation2 = hijack_and_drive_again(demo)
    trajectory = load_navigation(data / "navigations" / navigation1 / "navigation").trajectory
    verdict = judge(
        trajectory, centroids(places), demo.simulator.truth_log(), samples, put_down_ns, middles(demo), true_rooms(demo)
    )
    return Outcome(verdict, places, trajectory, navigation2)


def centroids(places: list[dict[str, Any]]) -> dict[str, FloatArray]:
    """Of places as GET /places gives them: id -> (3,) centroid, map frame."""
    return {p["id"]: np.array(p["centroid_map"]) for p in places}


def middles(demo: Demo) -> dict[str, FloatArray]:
    """A free spot (3,) in the middle of each room, map frame: on the plan's ground, whose height says nothing."""
    R_ground_map = np.array(demo.station.get("/floorplan")["R_ground_map"])
    return {room["id"]: np.array([*room["middle"], 0.0]) @ R_ground_map for room in demo.station.get("/rooms")}


def true_rooms(demo: Demo) -> list[TrueRoom]:
    """Of the simulated flat."""
    rooms = demo.simulator.ask(cmd="flat")["rooms"]
    return [TrueRoom(r["name"], (r["x0_m"], r["y0_m"]), (r["x1_m"], r["y1_m"])) for r in rooms]


def start_programs(
    options: DemoOptions, programs: Programs, data: Path, say: Say, settings: Path | None = None
) -> Demo:
    """robot-server with simulated devices, and the station; wait until pictures arrive.

    `settings`: robot-server's; None: those of the demo.
    """
    say(f"simulated robot in world {options.world}, flat {options.seed}; logs in {options.out / 'logs'}")
    settings = settings or write_settings(options.out)
    robot_port, sim_port, port = free_port(), free_port(), options.port or free_port()
    programs.start(
        "robot-server",
        "robot.main",
        *("--devices", "simulated", "--world", options.world, "--seed", str(options.seed)),
        *("--port", str(robot_port), "--sim-port", str(sim_port), "--config", str(settings)),
    )
    serve = ["serve", "--robot", f"127.0.0.1:{robot_port}", "--port", str(port), "--data", str(data)]
    programs.start("station", "station.main", *serve, *(("--backend", options.backend) if options.backend else ()))
    station = StationClient(f"http://127.0.0.1:{port}")
    wait_for(programs, "the station", lambda: station.is_up(), START_TIMEOUT_S)
    wait_for(programs, "the robot", lambda: station.get("/robot")["rates"]["frames_hz"] > 1, START_TIMEOUT_S)
    say(f"page, live video and API: {station.address}")
    return Demo(options, programs, station, SimulatorClient(sim_port), sim_port, say)


def write_settings(folder: Path) -> Path:
    """robot-server's settings, and the simulator's: in each room of the flat hangs a sticker with its name."""
    simulation, settings = (folder / "simulation.toml").absolute(), folder / "robot.toml"
    simulation.write_text("stickers = true\n", encoding="utf-8")
    settings.write_text(f"[simulated]\nsettings = {json.dumps(str(simulation))}\n", encoding="utf-8")
    return settings


def record_mapping(demo: Demo, name: str) -> str:
    """Record one navigation while the scripted driver looks at all rooms; its id."""
    navigation: str = demo.station.call("POST", "/navigations", {"name": name})["id"]
    demo.say(f"{name}: driving round every room, once each way (a minute and a half)")
    start_driver(demo, "tour", "brisk")
    demo.programs.wait("driver", DRIVE_TIMEOUT_S)
    demo.station.call("POST", f"/navigations/{navigation}/stop")
    demo.say(f"{name}: driven; SLAM finds trajectory and landmarks (a quarter of a minute, more on a busy machine)")
    return navigation


def start_driver(demo: Demo, route: str, pace: str = "calm") -> None:
    """The scripted driver: real drive commands through the station, as a person with a joystick gives them."""
    demo.programs.start(
        "driver",
        "robot.simulation.cli",
        *("drive", "--station", demo.station.address, "--sim-port", str(demo.sim_port)),
        *("--route", route, "--seed", str(demo.options.seed), "--pace", pace),
    )


def wait_for_slam(demo: Demo, name: str, navigation: str, *, is_for_map: bool = False) -> None:
    """Wait until SLAM has made trajectory and landmarks of the navigation.

    `is_for_map`: where it was too slow for many pictures, it runs over the recording again.
    """

    def progress() -> object:
        return demo.station.get("/pose")["message"]

    drive = wait_until_over(demo, "SLAM", f"/navigations/{navigation}", SLAM_TIMEOUT_S, progress)
    left_out = drive["frames_skipped"]
    if is_for_map and left_out > TOO_MANY_LEFT_OUT * drive["frames"]:
        demo.say(
            f"{name}: this computer is busy: {left_out} of {drive['frames']} pictures came too quickly for SLAM while"
            " the robot drove. The recording has them all: SLAM runs over it again (a minute, more on a busy machine)"
        )
        job = demo.station.call("POST", f"/navigations/{navigation}/reprocess", {})["id"]
        wait_until_over(demo, "SLAM", f"/jobs/{job}", SLAM_TIMEOUT_S, lambda: demo.station.get(f"/jobs/{job}"))
        drive, left_out = demo.station.get(f"/navigations/{navigation}"), 0
    without = f", {left_out} of them left out by SLAM" if left_out else ""
    demo.say(
        f"{name}: {drive['duration_s']:.0f} s, {drive['frames']} frames{without}, {drive['imu_samples']} IMU samples "
        f"({drive['imu_lost']} lost) → {drive['landmarks']} landmarks ({drive['backend']}, {drive['scale']} scale)"
    )


def build_map(demo: Demo, navigation: str) -> list[dict[str, Any]]:
    """Cluster the landmarks into places and use the map."""
    order = {"navigations": [navigation], "name": "Demo flat", "places": demo.options.places}
    job = demo.station.call("POST", "/maps", order)["id"]
    wait_until_in_use(demo, job)
    places: list[dict[str, Any]] = demo.station.get("/places")
    demo.say(f"map with {len(places)} places:")
    width = max(len(place["name"]) for place in places)
    for place in places:
        x, y, _ = place["centroid_map"]
        demo.say(f"    {place['name']:{width}s} {place['landmarks']:5d} landmarks at ({x:+.1f}, {y:+.1f}) m")
    name_rooms(demo)
    named: list[dict[str, Any]] = demo.station.get("/places")  # called after their rooms' names
    return named


def wait_until_in_use(demo: Demo, job: str) -> None:
    """Wait until the map that a job builds is used; the job goes on, reading door plates. Raises as its words say."""

    def is_used() -> bool:
        answer = demo.station.get(f"/jobs/{job}")
        if answer["state"] in ("failed", "cancelled"):
            raise RobotSystemError(f"the map failed: {answer['message']}")
        return any(each["active"] for each in demo.station.get("/maps"))

    wait_for(demo.programs, "the map", is_used, MAP_TIMEOUT_S)


def name_rooms(demo: Demo) -> None:
    """Give rooms the names that stickers in the flat speak for alone, as a person does who presses "Use it"."""
    for room in demo.station.get("/rooms"):
        for suggestion in [s for s in room["suggestions"] if s["confidence"] > LIKELY]:
            demo.station.call("PATCH", f"/rooms/{room['id']}", {"name": suggestion["name"]})
            demo.say(f"    {room['name']} is the {suggestion['name']}: {suggestion['reason']}")
    rooms = demo.station.get("/rooms")
    demo.say("rooms: " + ", ".join(f"{room['name']} ({room['area_m2'] or 0:.0f} m²)" for room in rooms))


def wait_for_localisation(demo: Demo) -> None:
    """Wait until pictures are looked for in the map; says where the robot is before anybody moves it."""
    get = demo.station.get
    wait_for(demo.programs, "localisation", lambda: get("/place/current")["t_robot_ns"] is not None, MAP_TIMEOUT_S)
    ask(demo, told="")


def hijack_and_drive_again(demo: Demo) -> tuple[int, list[Sample], str]:
    """Pick the robot up, put it down elsewhere, drive again and ask.

    Returns the robot time it was put down, the answers, and Navigation2's id; that is still being recorded.
    """
    put_down_ns = hijack(demo)
    navigation: str = demo.station.call("POST", "/navigations", {"name": "Navigation2"})["id"]
    demo.say("Navigation2: driving another route and asking GET /place/current")
    start_driver(demo, "second")
    samples: list[Sample] = []
    told = ""
    end_ns = put_down_ns + round(SECOND_DRIVE_S * 1e9)
    while demo.simulator.ask(cmd="truth")["t_robot_ns"] < end_ns:
        demo.programs.check(may_end="driver")
        sample, told = ask(demo, told)
        if sample is not None:
            samples.append(sample)
        time.sleep(ASK_EVERY_S)
    if demo.programs.is_known("driver"):
        demo.programs.end("driver")
    demo.station.call("POST", "/stop")
    return put_down_ns, samples, navigation


def hijack(demo: Demo) -> int:
    """Move the robot to a random free spot of the flat; the robot time it stands there."""
    answer = demo.simulator.ask(cmd="hijack", seed=demo.options.seed)
    demo.say(f"hijack: the robot is picked up and put down in the {answer['room']}")
    while demo.simulator.ask(cmd="truth")["t_robot_ns"] < answer["t_end_ns"]:
        time.sleep(0.1)
    return int(answer["t_end_ns"])


def ask(demo: Demo, told: str) -> tuple[Sample | None, str]:
    """One question for the current place; says it when the answer changed."""
    answer = demo.station.get("/place/current")
    place, room, is_elsewhere = answer["place"], answer["room"], answer["place_elsewhere"]
    named = where(place["name"] if place else "", room["name"] if room else "", is_elsewhere)
    two = sorted(answer["one_of_two"], key=lambda one: str(one["name"]))  # of two alike either may be ahead
    words = named or (f"in {' or '.join(one['name'] for one in two)}" if two else answer["state"])
    if words != told:
        of_room = room["probability"] if room and (not place or is_elsewhere) else None
        probability = answer["probability"] if place and of_room is None else of_room
        shares = [one["probability"] for one in two] if probability is None else [probability]
        sure = f" ({' or '.join(f'{share:.0%}' for share in shares)})" if shares else ""
        demo.say(f"    current place: {words}{sure}: {answer['reason']}")
    if answer["t_robot_ns"] is None:
        return None, words
    p = answer["position_map"]
    position = (p[0], p[1], p[2]) if p else None
    place_id, room_id = place["id"] if place else None, room["id"] if room else None
    return Sample(answer["t_robot_ns"], answer["state"], place_id, answer["probability"], position, room_id), words


def finish(demo: Demo, navigation2: str) -> None:
    """Let SLAM finish Navigation2: ended now, it would stay in the library as failed. The verdict stands already."""
    demo.say("Navigation2: SLAM finishes it, for the library")
    try:
        wait_for_slam(demo, "Navigation2", navigation2)
    except RobotSystemError as exc:
        demo.say(f"Navigation2: {exc}")


def serve_until_interrupted(demo: Demo) -> None:
    """Keep everything running: now the person drives."""
    demo.say(f"your turn: open {demo.station.address}, drive, hijack, ask. Ctrl-C ends.")
    told = ""
    try:
        while True:
            demo.programs.check(may_end="driver")
            try:
                _, told = ask(demo, told)
            except RobotSystemError as exc:  # a busy computer; what has ended is told by the check
                demo.say(f"    no answer: {exc}")
            time.sleep(ASK_EVERY_S)
    except KeyboardInterrupt:
        demo.say("ending: motors off, then the station finishes what it writes (some seconds)")


def wait_for(
    programs: Programs,
    what: str,
    is_ready: Callable[[], bool],
    timeout_s: float,
    progress: Callable[[], object] = lambda: None,
) -> None:
    """Wait for a condition while the programs live; the time counts anew whenever `progress` returns something else."""
    end = time.monotonic() + timeout_s
    reached = progress()
    while not is_ready():
        programs.check()
        if reached != (now := progress()):
            reached, end = now, time.monotonic() + timeout_s
        if time.monotonic() > end:
            raise RobotSystemError(
                f"{what} was not ready within {timeout_s:.0f} s: this computer is too busy, or it hangs;"
                " see the demo's logs"
            )
        time.sleep(0.2)


def wait_until_over(
    demo: Demo, what: str, path: str, timeout_s: float, progress: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Wait until a navigation or a job is over; what the station says of it then. Raises its words where it failed."""
    answer: dict[str, Any] = {}

    def is_over() -> bool:
        answer.update(demo.station.get(path))
        if answer["state"] in ("failed", "cancelled"):
            raise RobotSystemError(f"{what} failed: {answer['message']}")
        return answer["state"] in ("ready", "done")

    wait_for(demo.programs, what, is_over, timeout_s, progress)
    return answer


def write_results(options: DemoOptions, verdict: Verdict, timings: Timings, places: list[dict[str, Any]]) -> None:
    """`results.json`: for scripts and for benchmarks/bench_demo.py."""
    results = {
        "passed": verdict.passed,
        "shortfall": verdict.shortfall,
        "seed": options.seed,
        "world": options.world,
        "places": len(places),
        **asdict(verdict),
        "seconds": timings.seconds | {"total": round(sum(timings.seconds.values()), 1)},
    }
    write_json(options.out / "results.json", results)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Whole or not at all: a reader never sees half a file."""
    replace_file(path, (json.dumps(content, indent=1) + "\n").encode())


def describe(verdict: Verdict) -> str:
    """The verdict in a sentence."""
    known = verdict.right + verdict.wrong
    when = "never" if verdict.seconds_to_first_known is None else f"after {verdict.seconds_to_first_known:.1f} s"
    return (
        f"judged by the simulator's truth: {verdict.right} of {known} known answers right, "
        f"{verdict.not_known} not known, "
        f"first known {when}; {verdict.rooms_right} of {verdict.rooms_right + verdict.rooms_wrong} rooms right; "
        f"map error {verdict.map_error_m:.2f} m, scale {verdict.map_scale:.3f}: "
        + (f"FAILED: {verdict.shortfall}" if verdict.shortfall else "PASSED")
    )
