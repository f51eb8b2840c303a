"""Every value that the API turns into a model by `Model.of` has the fields that the model takes from it."""

from __future__ import annotations

import ast
import dataclasses
import importlib
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest
from pydantic import ValidationError

import station.api
from shared.calibration import CameraCalibration, WheelCalibration
from shared.messages import Capabilities, DriveApplied
from shared.token_book import TokenRecord
from station.api.access import TokenModel
from station.api.schema.base import Model
from station.api.schema.calibration import CameraModel, WheelsModel
from station.api.schema.calibration_session import BoardSeenModel, CalibrationSessionModel, MeterModel
from station.api.schema.comparisons import ComparisonModel
from station.api.schema.jobs import JobModel
from station.api.schema.maps import MapOrder
from station.api.schema.navigations import BinModel, NavigationModel, NavigationStart
from station.api.schema.places import EdgeModel, PlaceModel, PlacesChangeModel, RouteModel, VisitModel
from station.api.schema.robot import (
    AppliedModel,
    CalibrationFitModel,
    CapabilitiesModel,
    ClockModel,
    LossesModel,
    NetworkModel,
    RobotModel,
)
from station.api.schema.rooms import NameSuggestionModel, PlanRoom, RoomModel
from station.api.schema.station import LogModel
from station.events import LogLine
from station.library.bin import BinEntry
from station.library.comparisons import Comparison
from station.library.navigation_records import NavigationRecord
from station.library.place_changes import PlacesChange
from station.model.calibration_fit import CalibrationFit
from station.model.floor_plan import NameSuggestion, Room
from station.model.place_map import Place, PlaceEdge
from station.places.making.graph import Route
from station.robots.guided_calibration import CalibrationSession
from station.robots.link_state import LinkState
from station.robots.network import NetworkState
from station.robots.visits import Visit
from station.workers.calibration_interface import BoardSeen, MeterReading
from station.workers.jobs import Job

MADE_OF: dict[type[Model], type] = {
    AppliedModel: DriveApplied,
    BinModel: BinEntry,
    BoardSeenModel: BoardSeen,
    CalibrationFitModel: CalibrationFit,
    CalibrationSessionModel: CalibrationSession,
    CameraModel: CameraCalibration,
    CapabilitiesModel: Capabilities,
    ClockModel: LinkState,
    ComparisonModel: Comparison,
    EdgeModel: PlaceEdge,
    JobModel: Job,
    LogModel: LogLine,
    LossesModel: LinkState,
    MeterModel: MeterReading,
    NetworkModel: NetworkState,
    NavigationModel: NavigationRecord,
    NameSuggestionModel: NameSuggestion,
    PlaceModel: Place,
    PlacesChangeModel: PlacesChange,
    PlanRoom: Room,
    RobotModel: LinkState,
    RoomModel: Room,
    RouteModel: Route,
    TokenModel: TokenRecord,
    VisitModel: Visit,
    WheelsModel: WheelCalibration,
}


class Conversion(NamedTuple):
    """One call of `Model.of` in the source."""

    model: type[Model]
    others: set[str]
    where: str


def conversions() -> list[Conversion]:
    """All calls of `Model.of` below station/api."""
    found = []
    root = Path(station.api.__file__).parent
    for path in sorted(root.rglob("*.py")):
        name = ".".join(["station.api", *path.relative_to(root).with_suffix("").parts])
        for node in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "of"):
                continue
            assert isinstance(node.func.value, ast.Name), f"{name}:{node.lineno}: name the model in the call"
            model = getattr(importlib.import_module(name), node.func.value.id)
            assert issubclass(model, Model)
            others = {keyword.arg for keyword in node.keywords if keyword.arg is not None}
            assert len(others) == len(node.keywords), f"{name}:{node.lineno}: write out what is given"
            found.append(Conversion(model, others, f"{name}:{model.__name__}"))
    return found


def fields(kind: type) -> set[str]:
    """What can be read from a value of this type: its fields and properties."""
    if dataclasses.is_dataclass(kind):
        names = {field.name for field in dataclasses.fields(kind)}
    else:
        names = {field.name for field in msgspec.structs.fields(kind)}
    return names | {name for name in dir(kind) if isinstance(getattr(kind, name), property)}


CONVERSIONS = conversions()


def test_every_model_made_of_a_value_is_listed_here() -> None:
    assert {conversion.model for conversion in CONVERSIONS} == MADE_OF.keys()


@pytest.mark.parametrize("conversion", CONVERSIONS, ids=lambda conversion: conversion.where)
def test_a_value_has_all_fields_that_its_model_takes(conversion: Conversion) -> None:
    model, others, _ = conversion
    assert others <= model.model_fields.keys()
    assert model.model_fields.keys() - others <= fields(MADE_OF[model])


@pytest.mark.parametrize("name", ["  ", "\u200b", "a\u200bb", "a\x00b", "x" * 81])
def test_what_begins_gets_no_name_that_a_later_one_could_not_be(name: str) -> None:
    assert NavigationStart(name="").name == "" and MapOrder(navigations=["nav-1"], name="Flat").name == "Flat"
    for make in (lambda: NavigationStart(name=name), lambda: MapOrder(navigations=["nav-1"], name=name)):
        with pytest.raises(ValidationError):
            make()
