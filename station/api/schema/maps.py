"""The map library."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from station.api.schema.base import Model, OptionalName, Question
from station.config import MAX_ACTIVE_MAPS
from station.library.active_maps import ActiveMaps
from station.model.best_camera import misfit_of
from station.model.map_store import MapSummary
from station.model.place_map import PlaceGrain


class MapModel(Model):
    id: str
    name: str
    places: int
    active: bool = Field(description="robots are looked for in it")
    first: bool = Field(description="it is the active map whose places GET /places and GET /graph show")
    misfit: str = Field(
        description="a sentence, where the map is active and the calibration of its navigation does not fit, or seems "
        "not to and is not known yet",
        examples=[""],
    )
    damaged: str = Field(description="a sentence, where the map cannot be read", examples=[""])


class MapOrder(Question):
    """What to build a map from."""

    navigations: list[str] = Field(min_length=1, max_length=20, examples=[["nav-20260105-101500"]])
    name: OptionalName = Field(default="", examples=["Flat"])
    mode: Literal["default", "thesis"] | None = None
    places: PlaceGrain = Field(
        default="rooms",
        description="at most six in each room, or every cluster of landmarks (in thesis mode always)",
    )
    activate: bool = Field(default=True, description="use the map as soon as it is built")


class MapChoice(Question):
    """Where robots are looked for."""

    id: str | None = Field(description="null: no map", examples=["map-0a1b"])
    also: list[str] = Field(
        default_factory=list,
        max_length=MAX_ACTIVE_MAPS - 1,
        description="further maps, of other rooms; their order means nothing",
        examples=[["map-7c2d"]],
    )

    @model_validator(mode="after")
    def _has_a_first(self) -> Self:
        if self.id is None and self.also:
            raise ValueError("no map is to be in use, and yet others also: name one of them as id")
        return self


def map_model(summary: MapSummary, active: ActiveMaps) -> MapModel:
    first, found = active.first, active.find(summary.id)
    return MapModel(
        id=summary.id,
        name=summary.name,
        places=summary.places,
        active=found is not None,
        first=first is not None and first.place_map.id == summary.id,
        misfit="" if found is None else misfit_of(found.place_map.navigation.report),
        damaged=summary.damaged,
    )
