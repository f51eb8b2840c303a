"""What all of them share."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from shared.text import is_printable, is_seen_whole

MAX_FIELDS = 40
Number = Annotated[float, Field(allow_inf_nan=False)]


def _not_blank(name: str) -> str:
    if not name.strip():
        raise ValueError("a name needs a character that is no space")
    if not is_seen_whole(name) and is_printable(name):  # what cannot be shown has a sentence of its own
        raise ValueError("a character cannot be seen, such as a space of no width")
    return name


Name = Annotated[str, Field(max_length=80, json_schema_extra={"pattern": r"\S"}), AfterValidator(_not_blank)]
OptionalName = Annotated[  # empty: the station makes one
    str, Field(max_length=80), AfterValidator(lambda name: _not_blank(name) if name else name)
]


class Model(BaseModel):
    """Base of all: questions with unknown fields are refused, so that a typing error is seen."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def of(cls, value: object, **others: Any) -> Self:
        """Made of a value of the station: `others` as they are given, the rest from its fields of the same names."""
        return cls(**{name: getattr(value, name) for name in cls.model_fields if name not in others}, **others)


class Question(Model):
    """Base of what is asked: no value is taken for another kind, so that `true` is no speed. No text holds characters
    that cannot be shown: much of it is a name, or ends in a log.
    """

    model_config = ConfigDict(strict=True)

    @model_validator(mode="before")
    @classmethod
    def _has_few_fields(cls, value: object) -> object:
        if isinstance(value, dict) and len(value) > MAX_FIELDS:  # each unknown one would be a mistake of its own
            raise ValueError(f"{len(value)} fields are more than any question has")
        return value

    @field_validator("*")
    @classmethod
    def _is_printable(cls, value: object) -> object:
        for text in value if isinstance(value, list) else [value]:
            if isinstance(text, str) and not is_printable(text):
                raise ValueError("a character cannot be shown, such as a control character")
        return value


class Problem(BaseModel):
    """What went wrong (RFC 9457)."""

    type: str = Field(examples=["/problems/not-driver"])
    title: str = Field(examples=["Another one drives"])
    status: int = Field(examples=[409])
    detail: str = Field(examples=["anna drives; take over with POST /drive/take-over"])
    instance: str = Field(examples=["/drive"])


class NewName(Question):
    """What it shall be called."""

    name: Name = Field(examples=["Ground floor"])


class Accepted(Model):
    """Done."""

    ok: Literal[True] = True
