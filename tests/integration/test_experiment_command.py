"""`station map`, `match` and `experiment` on finished navigations: files of the contract, sentences for mistakes."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from shared.errors import RobotSystemError
from shared.geometry import FloatArray, quat_from_rotation, se3, yaw_rotation
from station.files.navigation_folder import load_navigation, save_navigation
from station.main import app
from station.maps.folder import load_map_folder, save_map_folder
from station.maps.store import MapStore
from station.places.making.build import build_map
from station.places.making.changes import with_place_hidden
from tests.support.synthetic_home import drive, furnished_room, navigate, with_points

pytestmark = pytest.mark.computing


def write_asl_truth(poses: FloatArray, folder: Path) -> None:
    """An ASL folder that holds nothing but the true states."""
    lines = ["#timestamp [ns],p,q,v,bw,ba"]
    for k, T in enumerate(poses):
        numbers = [*T[:3, 3], *quat_from_rotation(T[:3, :3]), *np.zeros(9)]
        lines.append(",".join([str(k * 100_000_000), *(f"{x:.9f}" for x in numbers)]))
    state = folder / "mav0" / "state_groundtruth_estimate0"
    state.mkdir(parents=True)
    (state / "data.csv").write_text("\n".join(lines) + "\n")
    imu = folder / "mav0" / "imu0"
    imu.mkdir()
    rows = [f"{k * 5_000_000},0,0,0,0,0,9.81" for k in range(20 * len(poses))]
    (imu / "data.csv").write_text("\n".join(["#timestamp [ns],w,a", *rows]) + "\n")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data")
    home = furnished_room(3, density=300)
    for number, (seed, T) in enumerate(((31, np.eye(4)), (32, se3(yaw_rotation(2.0), np.array([3.0, 1.0, 0.0])))), 1):
        poses = drive(home, seed, frames=45)
        save_navigation(navigate(home, poses, seed=seed, T_nav_world=T), root / f"nav{number}")
        write_asl_truth(poses, root / f"truth{number}")
    save_map_folder(build_map(load_navigation(root / "nav1")), root / "map1")
    imu_only = root / "imu_only" / "mav0" / "imu0"
    imu_only.mkdir(parents=True)
    (imu_only / "data.csv").write_text("0,0,0,0,0,0,9.81\n1000000,0,0,0,0,0,9.81\n")
    images = root / "images"
    images.mkdir()
    for k in range(3):
        cv2.imwrite(str(images / f"{k}.png"), np.full((48, 64), 90, np.uint8))
    (images / "camera-intrinsics.txt").write_text("60 0 32\n0 60 24\n0 0 1\n")
    return root


@pytest.fixture(scope="module")
def built(data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """What building a map of the first navigation told, and the map; its places are called after rooms."""
    folder = tmp_path_factory.mktemp("built") / "map"
    return run("map", "build", data / "nav1", "--out", folder, "--name", "Flat"), folder


@pytest.fixture(scope="module")
def matched(data: Path, built: tuple[str, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """What matching that map with the second navigation told, and the folder that it wrote."""
    out = tmp_path_factory.mktemp("matched") / "out"
    return run("match", built[1], data / "nav2", "--out", out), out


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def test_an_experiment_writes_results_report_and_figures(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    printed = run(
        "experiment", "--navigation1", data / "nav1", "--navigation2", data / "nav2",
        "--truth1", data / "truth1", "--truth2", data / "truth2", "--out", out, "--json",
    )  # fmt: skip
    results = json.loads((out / "results.json").read_text())
    assert json.loads(printed.splitlines()[-1]) == results
    assert {"places", "locations", "registration", "matches", "precision", "recall", "truth"} <= results.keys()
    assert results["truth"] == "groundtruth" and results["registration"]["accepted"]
    assert results["precision"] == 1.0 and results["recall"] >= 0.7
    assert 0 < results["registration"]["uncertainty"]["position"] < 0.1
    rmse, normalised = results["registration"]["rmse"], results["registration"]["rmse_normalised"]
    cloud = load_navigation(data / "nav1").landmarks.p_world
    assert normalised == pytest.approx(rmse / np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).max())
    for match in results["matches"]:
        assert {"place", "location", "distance", "correct"} <= match.keys()
    figures = {path.stem for path in (out / "figures").glob("*.png")}
    assert {
        "frames",
        "routes",
        "coloured_clouds",
        "clouds_before",
        "clouds_after",
        "clusters_above",
        "clusters_in_front",
        "matches",
        "trajectories",
    } <= figures
    assert {f"match_{k:02d}" for k in range(1, len(results["matches"]) + 1)} <= figures
    page = (out / "report.html").read_text()
    assert page.count('src="data:image/png;base64,') == len(figures)
    assert not re.search(r'(src|href)="(?!data:)', page), "the page must be one file"
    row = r"<td>[01](?:\.\d+)?</td><td>(?:yes|no)</td></tr>"  # repeatability, found again
    assert len(re.findall(row, page)) == results["places"] and re.search(r"[\d.]+°, [\d.]+ m, 0 of scale", page)
    assert not [path for path in out.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("p", "why"),
    [
        (np.zeros((0, 3)), "the navigation has no landmarks"),
        (np.full((60, 3), np.nan), "none of its 60 landmarks is finite"),
        (np.ones((1, 3)), "its landmarks (1) form no group"),
    ],
    ids=["empty", "all NaN", "one point"],
)
def test_a_map_without_places_says_why(data: Path, tmp_path: Path, p: FloatArray, why: str) -> None:
    save_map_folder(build_map(with_points(load_navigation(data / "nav1"), p)), tmp_path / "map")
    assert f"no place: {why}" in run("map", "show", tmp_path / "map")


def test_a_map_without_places_is_matched_with_nothing_and_says_so(data: Path, tmp_path: Path) -> None:
    whole = load_map_folder(data / "map1")
    save_map_folder(replace(whole, places=(), edges=()), tmp_path / "map")
    told = run("match", tmp_path / "map", data / "nav2", "--out", tmp_path / "out")
    assert "0 places" in told and "the map holds no place" in told
    assert "The map holds no place" in (tmp_path / "out" / "report.html").read_text()
    assert json.loads((tmp_path / "out" / "results.json").read_text())["matches"] == []


def test_a_map_is_built_shown_and_matched(
    data: Path, built: tuple[str, Path], matched: tuple[str, Path], tmp_path: Path
) -> None:
    assert "places" in built[0]
    shutil.copytree(built[1], tmp_path / "map")
    graph = json.loads(run("map", "show", tmp_path / "map", "--json"))
    names = [node["name"] for node in graph["nodes"]]
    assert (tmp_path / "map" / "graph.graphml").read_text().startswith("<?xml") or "<graphml" in (
        tmp_path / "map" / "graph.graphml"
    ).read_text()
    way = run("map", "route", tmp_path / "map", names[0], names[-1])
    assert way.startswith(f"{names[0]} > ") and re.search(rf"to {names[-1]}: [\d.]+ m at -?\d+ degrees", way)
    route = json.loads(run("map", "route", tmp_path / "map", names[0], names[-1], "--json"))
    assert route["names"][0] == names[0] and len(route["legs"]) == len(route["names"]) - 1
    measured = run("map", "show", tmp_path / "map", "--repeatability")
    assert len(re.findall(r"quality [01]\.\d\d, repeatability [01]\.\d\d\n", measured)) == len(names)
    nodes = json.loads(run("map", "show", tmp_path / "map", "--repeatability", "--json"))["nodes"]
    assert all(0 <= node["repeatability"] <= 1 for node in nodes)
    shown = run("map", "show", tmp_path / "map")
    assert len(re.findall(r"images, quality [01]\.\d\d\n", shown)) == len(names)
    assert len(re.findall(r"[\d.]+ m at -?\d+ degrees, (?:seen|driven|nearest)", shown)) == len(graph["edges"])
    run("map", "build", data / "nav1", "--out", tmp_path / "map", "--names-from", tmp_path / "map")
    assert [n["name"] for n in json.loads(run("map", "show", tmp_path / "map", "--json"))["nodes"]] == names
    results = json.loads((matched[1] / "results.json").read_text())
    assert results["truth"] == "none" and results["precision"] is None
    assert results["matches"] and all(match["correct"] is None for match in results["matches"])
    # A place that a person hides is no answer any more, and not in the graph; its neighbours are.
    place_map = load_map_folder(tmp_path / "map")
    hidden = results["matches"][0]["place"]
    (hidden_id,) = (place.id for place in place_map.places if place.name == hidden)
    save_map_folder(with_place_hidden(place_map, hidden_id, hidden=True), tmp_path / "map")
    run("match", tmp_path / "map", data / "nav2", "--out", tmp_path / "again")
    again = json.loads((tmp_path / "again" / "results.json").read_text())
    assert again["places"] == results["places"] - 1
    assert again["matches"] and hidden not in {match["place"] for match in again["matches"]}
    run("export", tmp_path / "map", "--format", "graphml", "--out", tmp_path / "shown.graphml")
    assert f'id="{hidden_id}"' not in (tmp_path / "shown.graphml").read_text()


@pytest.mark.parametrize(("command", "more"), [("experiment", ()), ("match", ("--json",))])
def test_a_refused_registration_is_no_success_and_its_report_is_written_all_the_same(
    data: Path, tmp_path: Path, command: str, more: tuple[str, ...]
) -> None:
    elsewhere = furnished_room(9, density=300)
    save_navigation(navigate(elsewhere, drive(elsewhere, 32, frames=45), seed=32), tmp_path / "elsewhere")
    inputs = {
        "experiment": ["--navigation1", data / "nav1", "--navigation2", tmp_path / "elsewhere"],
        "match": [data / "map1", tmp_path / "elsewhere"],
    }
    out = tmp_path / "out"
    result = CliRunner().invoke(app, [command, *map(str, inputs[command]), "--out", str(out), *more])
    assert result.exit_code == 2, result.output
    assert re.fullmatch(r"station: nothing was matched, since registration is refused: [^\n]+\n", result.stderr)
    results = json.loads((out / "results.json").read_text())
    assert not results["registration"]["accepted"] and results["matches"] == []
    assert (out / "report.html").is_file() and list((out / "figures").glob("*.png"))
    if more:
        assert json.loads(result.stdout.splitlines()[-1]) == results
    else:  # a person reads a reason per line
        reasons = results["registration"]["reasons"]
        assert "\n  ".join(["registration refused:", *reasons]) in result.stdout and len(reasons) > 1


def test_a_map_that_the_station_keeps_is_matched_by_its_id(
    data: Path, built: tuple[str, Path], matched: tuple[str, Path], tmp_path: Path
) -> None:
    store = MapStore(tmp_path / "station" / "maps")
    kept = load_map_folder(built[1])
    store.save(kept)
    store.close()
    out = tmp_path / "out"
    told = run("match", kept.id, data / "nav2", "--out", out, "--data", tmp_path / "station")
    told_of_folder, out_of_folder = matched
    assert told.replace(str(out), "OUT") == told_of_folder.replace(str(out_of_folder), "OUT")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["experiment"], "--navigation1 and --navigation2 are needed"),
        (["experiment", "--preset", "IV"], 'is "IV", must be one of I, II, III'),
        (["experiment", "--preset", "I"], "needs --euroc"),
        (["experiment", "--navigation1", "{nav1}", "--navigation2", "{nav1}", "--frames1", "a-b"], "such as 0-398"),
        (["experiment", "--navigation1", "{nav1}", "--navigation2", "{nav1}", "--frames1", "0-9"], "is a finished"),
        (["experiment", "--navigation1", "{nav1}", "--navigation2", "/nowhere"], "/nowhere does not exist"),
        (
            ["experiment", "--navigation1", "{nav1}", "--navigation2", "{nav1}", "--truth1", "{truth1}"],
            "give --truth1 and --truth2, or neither",
        ),
        (
            ["experiment", "--navigation1", "{nav1}", "--navigation2", "{nav1}", "--truth1", "{imu_only}"],
            "holds no true poses",
        ),
        (
            ["experiment", "--navigation1", "{images}", "--navigation2", "{images}", "--initial-state", "given"],
            "has no true velocity and biases",
        ),
        (
            ["experiment", "--navigation1", "{images}", "--navigation2", "{images}", "--landmarks", "thesis"],
            "use --backend ukf for them",
        ),
        (["match", "{map1}", "{nav1}", "--truth2", "{truth1}"], "--truth1 and --truth2"),
        (["match", "{nav1}", "{nav1}"], "holds no map"),
        (["map", "build", "{nav1}", "/nowhere"], "holds no navigation"),
    ],
)  # fmt: skip
def test_mistakes_get_one_sentence_and_leave_nothing(
    data: Path, tmp_path: Path, arguments: list[str], sentence: str
) -> None:
    names = ("nav1", "map1", "truth1", "imu_only", "images")
    filled = [a.format(**{name: data / name for name in names}) for a in arguments]
    with pytest.raises(RobotSystemError, match=re.escape(sentence)):
        run(*filled, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--mode", "--align-by"])
def test_a_word_that_is_no_choice_is_a_mistake_of_usage(data: Path, tmp_path: Path, option: str) -> None:
    words = ["match", str(data / "map1"), str(data / "nav1"), "--out", str(tmp_path / "out"), option, "x"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2 and "is not one of" in " ".join(result.output.split())
    assert not (tmp_path / "out").exists()


def test_too_few_true_poses_leave_the_matches_unjudged(data: Path, tmp_path: Path) -> None:
    home = furnished_room(3, density=300)
    write_asl_truth(drive(home, 31, frames=2), tmp_path / "short")
    out = tmp_path / "out"
    run(
        "match", data / "map1", data / "nav2", "--out", out,
        "--truth1", tmp_path / "short", "--truth2", data / "truth2",
    )  # fmt: skip
    results = json.loads((out / "results.json").read_text())
    assert results["truth"] == "none" and results["precision"] is None and "2 keyframes" in results["not_judged"]
    assert results["matches"] and all(match["correct"] is None for match in results["matches"])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["experiment", "--navigation1", "{drive}", "--navigation2", "/nowhere"], "/nowhere does not exist"),
        (["experiment", "--navigation1", "{drive}", "--navigation2", "{imu_only}"], "holds no camera images"),
        (["slam", "{drive}"], "is a file"),
        (["map", "build", "{nav1}"], "is a file"),
        (["match", "{map1}", "{nav1}"], "is a file"),
        (["experiment", "--navigation1", "{drive}", "--navigation2", "{drive}"], "is a file"),
    ],
)  # fmt: skip
def test_everything_is_checked_before_the_first_frame_is_reconstructed(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], sentence: str
) -> None:
    def too_late(*_: object) -> None:
        raise AssertionError("work began before everything was checked")

    for place in (
        "station.commands.slam.run_backend",
        "station.commands.match.match_navigation",
        "station.commands.map.make_map",
    ):
        monkeypatch.setattr(place, too_late)
    filled = [a.format(drive=data / "images", **{n: data / n for n in ("nav1", "map1", "imu_only")}) for a in arguments]
    (tmp_path / "file").write_text("mine")
    out = tmp_path / "file" if sentence == "is a file" else tmp_path / "out"
    with pytest.raises(RobotSystemError, match=re.escape(sentence)):
        run(*filled, "--out", out)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("command", [["slam", "{images}"], ["map", "build", "{nav1}"], ["export", "{nav1}"]])
def test_a_name_that_is_too_long_gets_a_sentence(data: Path, tmp_path: Path, command: list[str]) -> None:
    filled = [part.format(images=data / "images", nav1=data / "nav1") for part in command]
    more = ["--format", "tum"] if command[0] == "export" else []
    with pytest.raises(RobotSystemError, match="cannot be written"):
        run(*filled, "--out", tmp_path / ("x" * 300), *more)


def test_names_come_only_from_a_map_of_the_very_same_navigation(data: Path, tmp_path: Path) -> None:
    stranger = load_navigation(data / "nav1")
    save_navigation(replace(stranger, id=f"{stranger.id}0"), tmp_path / "longer")
    with pytest.raises(RobotSystemError, match="was made from"):
        run("map", "build", tmp_path / "longer", "--out", tmp_path / "map", "--names-from", data / "map1")
    assert not (tmp_path / "map").exists()
