"""Schemathesis over the station's OpenAPI document: ask every call with right and wrong values, judge each answer."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import FailureGroup
from schemathesis.core.parameters import ParameterLocation
from schemathesis.core.result import Err
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
    unsupported_method,
)

from station.library.comparisons import Comparison, Comparisons
from station.model.place_map import PlaceMap
from tests.support.station import DRAWN, store_split_map
from tests.support.station_at_work import keep_navigation

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    negative_data_rejection,
    unsupported_method,
]
ENDLESS = {
    "/camera/stream.mjpg",
    "/robots/{robot}/camera/stream.mjpg",
}  # answers until the asker goes; test_station.py looks at it
WORDS = (ParameterLocation.PATH, ParameterLocation.HEADER)  # parameters that arrive as text, whatever was meant
ORDER = {"get": 0, "patch": 1, "put": 2, "post": 3, "delete": 5}  # what is deleted can be asked for no more
MADE = {
    "POST /navigations": "navigation_id",
    "POST /robots/{robot}/navigations": "navigation_id",
    "POST /maps": "job_id",
    "POST /comparisons": "job_id",
}
RIGHT, WRONG = schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE


@dataclass
class Asked:
    """Which calls were asked, how they answered, and what was wrong about it."""

    statuses: defaultdict[str, Counter[int]] = field(default_factory=lambda: defaultdict(Counter))
    wrong: list[str] = field(default_factory=list)

    @property
    def never_answered(self) -> set[str]:
        """Calls that only ever refused."""
        return {call for call, counts in self.statuses.items() if not any(status < 300 for status in counts)}


def furnish(data_dir: Path) -> tuple[PlaceMap, dict[str, list[Any]]]:
    """One of everything in a station's folder; and what it is called, by the names of parameters and fields."""
    place_map = store_split_map(data_dir)
    drives = [keep_navigation(data_dir, name).id for name in ("nav-1", "nav-2")]
    comparisons = Comparisons(data_dir / "comparisons")
    comparison_id, folder = comparisons.prepare()
    (folder / "report.html").write_text("<!doctype html><title>Report</title>")
    (folder / "results.json").write_text("{}")
    first, second = drives
    comparisons.store(Comparison(comparison_id, "One", first, second, 1.0, 3, 3, 2, True, (), None), folder)
    places = [place.id for place in place_map.places]
    assert place_map.plan is not None
    rooms = [room.id for room in place_map.plan.rooms]
    return place_map, {
        "navigation_id": list(drives), "navigations": drives, "first": drives[:1], "second": drives,
        "map_id": [place_map.id], "id": [place_map.id], "place_id": places, "places": places,
        "start": places[:1], "goal": places,
        "room_id": list(rooms), "rooms": rooms, "door_id": [door.id for door in place_map.plan.doors],
        "line": [DRAWN.tolist()], "robot": ["robot-1"], "keyframe": [0, 1], "job_id": ["job-0"],
        "comparison_id": [comparison_id], "name": ["trajectory.tum", "landmarks.ply"],
    }  # fmt: skip


def ask_everything(address: str, known: dict[str, list[Any]], examples: int, seed: int | None = None) -> Asked:
    """Ask every documented call: up to `examples` times each with right and with wrong values."""
    document = schemathesis.openapi.from_url(f"{address}/openapi.json", timeout=60)
    asked = Asked()
    operations = []
    for found in document.get_all_operations():
        if isinstance(found, Err):
            raise found.err()
        operations.append(found.ok())
    for operation in sorted(operations, key=_when):
        if operation.path not in ENDLESS:
            for mode in (RIGHT, WRONG) if _can_be_wrong(operation) else (RIGHT,):
                _ask(operation, mode, known, examples, seed, asked)
    return asked


def _when(operation: Any) -> int:
    """Jobs after what makes them, restoring after deleting."""
    if operation.path.startswith("/jobs"):
        return 4
    if operation.path.endswith("/restore"):
        return 6
    return 7 if (operation.method, operation.path) == ("delete", "/bin") else ORDER[operation.method]


def _can_be_wrong(operation: Any) -> bool:
    """Whether there is a wrong way to ask. Schemathesis finds out by 459 attempts, each of 1 ms, that there is none."""
    return bool(operation.body) or not all(
        parameter.location in WORDS and _is_any_text(parameter.definition["schema"])
        for parameter in operation.iter_parameters()
    )


def _is_any_text(schema: dict[str, Any]) -> bool:
    """Whether every text is right: in WORDS there is nothing else."""
    if "anyOf" in schema:
        return any(map(_is_any_text, schema["anyOf"]))
    return schema.get("type") == "string" and schema.keys() <= {"type", "title", "description"}


def _ask(operation: Any, mode: Any, known: dict[str, list[Any]], examples: int, seed: int | None, asked: Asked) -> None:
    call = f"{operation.method.upper()} {operation.path}"

    def ask(case: schemathesis.Case[Any], data: st.DataObject) -> None:
        if mode is RIGHT:  # made-up names alone would only ever find nothing
            is_first = not asked.statuses[call]
            for values in (case.path_parameters, case.query, case.body):
                _name_what_is_there(values, known, data, is_first)
        answer = case.call_and_validate(checks=CHECKS, timeout=60)
        asked.statuses[call][answer.status_code] += 1
        if call in MADE and answer.status_code < 300:
            known[MADE[call]].append(answer.json()["id"])

    test = given(case=operation.as_strategy(generation_mode=mode), data=st.data())(ask)
    test = settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=seed is None,
        suppress_health_check=list(HealthCheck),
    )(test)
    if seed is not None:
        test = seeded(seed)(test)
    try:
        test()
    except Unsatisfiable:  # nothing was asked
        raise
    except (FailureGroup, Exception) as exc:  # all findings of a run are worth seeing
        asked.wrong.append(f"{call} ({mode.value}): {exc!s:.900}")


def _name_what_is_there(values: object, known: dict[str, list[Any]], data: st.DataObject, surely: bool) -> None:
    """Put names of what there is into a call's parameters or fields: the newest `surely`, otherwise any by chance."""
    if not isinstance(values, dict):
        return
    for name in [name for name in values if name in known and (surely or data.draw(st.integers(0, 3)))]:
        is_list = isinstance(values[name], list) and not isinstance(known[name][0], list)
        one = st.sampled_from(known[name])
        if surely:
            values[name] = known[name][-2:] if is_list else known[name][-1]
        else:
            values[name] = data.draw(st.lists(one, min_size=2, max_size=3) if is_list else one)
