"""Writes the page's TypeScript types from the API's Python models: `python -m station.api.page_types`.

A test holds `src/link/messages.ts` against this, so the two cannot drift apart.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter

from station.api import messages
from station.api.schema import (
    base,
    calibration,
    comparisons,
    fleet,
    jobs,
    maps,
    navigations,
    places,
    robot,
    rooms,
    slam,
    station,
)

BASES = (BaseModel, base.Model, base.Question)
TARGET = Path(__file__).parents[1] / "web" / "src" / "link" / "messages.ts"
PLAIN = {"string": "string", "integer": "number", "number": "number", "boolean": "boolean", "null": "null"}
HEAD = (
    "// Made by `python -m station.api.page_types` from station/api/schema and station/api/messages.py. Do not edit.\n"
)


def generate() -> str:
    """The TypeScript text."""
    definitions: dict[str, Any] = {}
    unions: dict[str, Any] = {
        "EventMessage": messages.EventMessage,
        "DriveRequest": messages.DriveRequest,
        "DriveAnswer": messages.DriveAnswer,
    }
    aliases = []
    for name, union in unions.items():
        schema = TypeAdapter(union).json_schema(mode="serialization")
        definitions |= schema["$defs"]
        aliases.append(f"export type {name} =\n" + "".join(f"  | {_type(option)}\n" for option in schema["oneOf"])[:-1])
    for model in _models():
        schema = model.model_json_schema(mode="serialization")
        definitions |= schema.pop("$defs", {})
        definitions[model.__name__] = schema
    interfaces = [_interface(name, definitions[name]) for name in sorted(definitions)]
    return HEAD + "\n" + "\n\n".join([*interfaces, *(alias + ";" for alias in aliases)]) + "\n"


def _models() -> Iterator[type[BaseModel]]:
    """Every model of the schema but the bases."""
    for module in (base, calibration, comparisons, fleet, jobs, maps, navigations, places, robot, rooms, slam, station):
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, BaseModel) and value not in BASES:
                yield value


def _interface(name: str, schema: dict[str, Any]) -> str:
    about = schema.get("description", "").split("\n")[0]
    lines = [f"/** {about} */"] if about and not about.startswith("Base of") else []
    lines.append(f"export interface {name} {{")
    for key, value in schema.get("properties", {}).items():
        if "description" in value:
            lines.append(f"  /** {value['description']} */")
        lines.append(f"  {key}: {_type(value)};")
    return "\n".join([*lines, "}"])


def _type(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " | ".join(json.dumps(value) for value in schema["enum"])
    if "anyOf" in schema:
        return " | ".join(dict.fromkeys(_type(option) for option in schema["anyOf"]))
    if schema.get("type") == "array":
        inner = _type(schema.get("items", {}))
        return f"({inner})[]" if " | " in inner else f"{inner}[]"
    if isinstance(schema.get("additionalProperties"), dict):
        return f"Record<string, {_type(schema['additionalProperties'])}>"
    return PLAIN.get(schema.get("type", ""), "unknown")


if __name__ == "__main__":
    TARGET.write_text(generate())
