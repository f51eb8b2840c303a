"""Writes the page's TypeScript types from the API's Python models: `python -m station.web.generate_types`.

A test holds `src/link/messages.ts` against this, so the two cannot drift apart.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter

from station.api import messages, models

TARGET = Path(__file__).parent / "src" / "link" / "messages.ts"
HEAD = "// Made by `python -m station.web.generate_types` from station/api/models.py and messages.py. Do not edit.\n"


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
    for model in vars(models).values():
        if (
            isinstance(model, type)
            and issubclass(model, BaseModel)
            and model
            not in (
                models.Model,
                models.Question,
                BaseModel,
            )
        ):
            schema = model.model_json_schema(mode="serialization")
            definitions |= schema.pop("$defs", {})
            definitions[model.__name__] = schema
    interfaces = [_interface(name, definitions[name]) for name in sorted(definitions)]
    return HEAD + "\n" + "\n\n".join([*interfaces, *(alias + ";" for alias in aliases)]) + "\n"


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
    match schema.get("type"):
        case "string":
            return "string"
        case "integer" | "number":
            return "number"
        case "boolean":
            return "boolean"
        case "null":
            return "null"
        case "array":
            inner = _type(schema.get("items", {}))
            return f"({inner})[]" if " | " in inner else f"{inner}[]"
        case "object" if isinstance(schema.get("additionalProperties"), dict):
            return f"Record<string, {_type(schema['additionalProperties'])}>"
    return "unknown"


if __name__ == "__main__":
    TARGET.write_text(generate())
