"""What all that the API is asked has in common."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import station.api
from station.api.schema.base import MAX_FIELDS, Question


def questions() -> list[type[Question]]:
    for module in pkgutil.walk_packages(station.api.__path__, "station.api."):
        importlib.import_module(module.name)
    return sorted(Question.__subclasses__(), key=lambda question: question.__name__)


def unbounded_lists(schema: object) -> list[object]:
    """The lists in a JSON schema that may be as long as one likes: each of their values may be a mistake."""
    if isinstance(schema, list):
        return [found for part in schema for found in unbounded_lists(part)]
    if not isinstance(schema, dict):
        return []
    here: list[object] = [schema] if schema.get("type") == "array" and "maxItems" not in schema else []
    return here + [found for part in schema.values() for found in unbounded_lists(part)]


@pytest.mark.parametrize("question", questions(), ids=lambda question: question.__name__)
def test_no_question_has_room_for_many_mistakes(question: type[Question]) -> None:
    assert len(question.model_fields) <= MAX_FIELDS
    assert unbounded_lists(question.model_json_schema()) == []
