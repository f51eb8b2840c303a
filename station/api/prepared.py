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
        self._made: WeakKeyDictionary[ActiveMap, asyncio.Task[bytes]] = WeakKeyDictionary()

    async def response(self, active: ActiveMap) -> Response:
        made = self._made.get(active)
        if made is None or (made.done() and (made.cancelled() or made.exception() is not None)):
            made = self._made[active] = asyncio.create_task(asyncio.to_thread(self._make, active))
        # Several may wait for it; that one of them is gone ends it for nobody.
        return Response(await asyncio.shield(made), media_type="application/json")
