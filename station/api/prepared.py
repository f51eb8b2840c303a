"""Large answers about the map in use."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from weakref import WeakKeyDictionary

from fastapi import Response

from station.library.active_maps import ActiveMap


class Prepared:
    """JSON made beside the event loop, once for each map in use, which changes make another one.

    Of a map of a thousand rooms a page reads megabytes, and every page the same ones.
    """

    def __init__(self, make: Callable[[ActiveMap], bytes]) -> None:
        self._make = make
        self._made: WeakKeyDictionary[ActiveMap, bytes] = WeakKeyDictionary()

    async def response(self, active: ActiveMap) -> Response:
        if (made := self._made.get(active)) is None:
            made = self._made[active] = await asyncio.to_thread(self._make, active)
        return Response(made, media_type="application/json")
