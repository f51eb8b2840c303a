"""What walls look like, in numbers: all of them, as `benchmarks/fit_rooms.py` writes `fitted.json`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import msgspec

GENERATED = Path(__file__).with_name("fitted.json")


class WallModel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Log odds of what is seen of pieces of planes and of cells, and from what flats they were counted."""

    made_by: str  # the command
    worlds: tuple[str, ...]  # kinds and seeds
    wall: tuple[float, ...]  # of each class of a piece: of a wall against anywhere in a room
    foot: tuple[float, ...]  # of each class of a piece's foot on the floor, as `wall`
    foot_weight: float  # neighbouring pieces are judged together: what one counts, where a piece counts 1
    area: tuple[float, ...]  # of each class of a cell: in a room against outside
    area_weight: float  # neighbouring cells say nearly the same: what one counts, where a piece counts 1
    door: float  # cost of a gap in a wall as wide as a door
    opening: float  # ... as wide as a double door, or an opening between two rooms
    gap: float  # ... of any other gap
    gap_piece: float  # ... and of each piece of it
    room: float  # cost of a room more
    lead: float  # nats by which a room is ahead of its rivals per unit of the log odds that it is right


@cache
def wall_model(path: Path = GENERATED) -> WallModel:
    """Raises msgspec.ValidationError where the file has other fields than this code reads."""
    return msgspec.json.decode(path.read_bytes(), type=WallModel)
