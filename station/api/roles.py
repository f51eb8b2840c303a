"""Which role each call and socket needs. One that is missing here keeps the station from starting."""

from __future__ import annotations

from collections.abc import Iterable

from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.routing import BaseRoute, compile_path

from shared.access import Role
from shared.errors import LocalProtocolError

OPEN, WATCH, DRIVE, ADMIN = None, Role.WATCH, Role.DRIVE, Role.ADMIN

# The calls to one robot: as they stand to the first one, below /robots/{robot} to each.
OF_ROBOT: dict[str, Role] = {
    "GET /robot": WATCH,
    "POST /stop": WATCH,  # whoever sees the robot may stop it
    "POST /drive": DRIVE,
    "POST /drive/take-over": DRIVE,
    "POST /drive/release": DRIVE,
    "POST /pan-tilt": DRIVE,
    "POST /robot/hijack": DRIVE,
    "GET /calibration": WATCH,
    "GET /calibration/file": WATCH,
    "GET /calibration/sessions": WATCH,
    "POST /calibration/sessions": DRIVE,
    "GET /calibration/sessions/{session_id}": WATCH,
    "GET /calibration/sessions/{session_id}/{name}": WATCH,
    "POST /calibration/sessions/{session_id}/finish": DRIVE,
    "DELETE /calibration/sessions/{session_id}": DRIVE,
    "POST /calibration/use": ADMIN,  # every later drive is measured with it
    "POST /calibration/undo": ADMIN,
    "POST /robot/pair": ADMIN,
    "WS /ws/drive": DRIVE,
    "GET /camera/frame.jpg": WATCH,
    "GET /camera/stream.mjpg": WATCH,
    "WS /ws/camera": WATCH,
    "WS /ws/events": WATCH,
    "GET /log": WATCH,
    "GET /pose": WATCH,
    "GET /trajectory": WATCH,
    "GET /landmarks": WATCH,
    "GET /place/current": WATCH,
    "GET /place/timeline": WATCH,
    "GET /place/current/images/{t_robot_ns}.jpg": WATCH,
    "POST /navigations": DRIVE,
}


def named(call: str) -> str:
    """The same call to a robot by its name: /stop is /robots/{robot}/stop then, /robot itself /robots/{robot}."""
    method, _, path = call.partition(" ")
    rest = path.removeprefix("/robot") if path == "/robot" or path.startswith("/robot/") else path
    return f"{method} /robots/{{robot}}{rest}"


# None: open to everybody, which only the page's own files are, and the door itself.
ROLES: dict[str, Role | None] = {
    **OF_ROBOT,
    **{named(call): role for call, role in OF_ROBOT.items()},
    "GET /": OPEN,
    "GET /assets/{name}": OPEN,
    "GET /favicon.svg": OPEN,
    "GET /favicon.ico": OPEN,
    "POST /login": OPEN,
    "POST /logout": WATCH,
    "GET /session": WATCH,
    "GET /docs": WATCH,
    "GET /docs/start.js": WATCH,
    "GET /docs/{name}": WATCH,
    "GET /openapi.json": WATCH,
    # Robots, maps of their places
    "GET /robots": WATCH,
    "WS /ws/replay": WATCH,
    "GET /healthz": WATCH,
    "GET /metrics": WATCH,
    "GET /places": WATCH,
    "GET /places/{place_id}": WATCH,
    "GET /places/{place_id}/images/{kind}": WATCH,
    "GET /graph": WATCH,
    "GET /graph/route": WATCH,
    "GET /places/changes": WATCH,
    "POST /places/undo": DRIVE,
    "PATCH /places/{place_id}": DRIVE,
    "POST /places/merge": DRIVE,
    "POST /places/repeatability": DRIVE,
    # Rooms
    "GET /rooms": WATCH,
    "GET /rooms/{room_id}": WATCH,
    "PATCH /rooms/{room_id}": DRIVE,
    "POST /rooms/merge": DRIVE,
    "POST /rooms/split": DRIVE,
    "DELETE /doors/{door_id}": DRIVE,
    "GET /floorplan": WATCH,
    # Maps and navigations
    "GET /calibration/target.pdf": WATCH,
    "GET /maps": WATCH,
    "GET /maps/{map_id}/landmarks": WATCH,
    "GET /maps/{map_id}/images/{keyframe}.jpg": WATCH,
    "POST /maps": DRIVE,
    "PUT /maps/active": DRIVE,
    "POST /maps/{map_id}/restore": DRIVE,
    "PATCH /maps/{map_id}": DRIVE,
    "DELETE /maps/{map_id}": ADMIN,
    "GET /navigations": WATCH,
    "GET /navigations/{navigation_id}": WATCH,
    "GET /navigations/{navigation_id}/landmarks": WATCH,
    "GET /navigations/{navigation_id}/replay": WATCH,
    "GET /navigations/{navigation_id}/replay.mjpg": WATCH,
    "GET /navigations/{navigation_id}/{name}": WATCH,
    "POST /navigations/{navigation_id}/stop": DRIVE,
    "POST /navigations/{navigation_id}/cancel": DRIVE,
    "POST /navigations/{navigation_id}/reprocess": DRIVE,
    "POST /navigations/{navigation_id}/restore": DRIVE,
    "PATCH /navigations/{navigation_id}": DRIVE,
    "DELETE /navigations/{navigation_id}": ADMIN,
    "GET /comparisons": WATCH,
    "GET /comparisons/{comparison_id}": WATCH,
    "GET /comparisons/{comparison_id}/{name}": WATCH,
    "POST /comparisons": DRIVE,
    "DELETE /comparisons/{comparison_id}": ADMIN,
    "GET /jobs": WATCH,
    "GET /jobs/{job_id}": WATCH,
    "DELETE /jobs/{job_id}": DRIVE,
    "GET /bin": WATCH,
    "DELETE /bin": ADMIN,
    # Who may
    "GET /access/tokens": ADMIN,
    "POST /access/tokens": ADMIN,
    "DELETE /access/tokens/{token_id}": ADMIN,
}


_OPEN = [(call.partition(" ")[0], compile_path(call.partition(" ")[2])[0]) for call in ROLES if ROLES[call] is OPEN]


def is_open(method: str, path: str) -> bool:
    """Whether everybody may call it."""
    return any(method == known and pattern.match(path) for known, pattern in _OPEN)


def calls_of(route: BaseRoute, prefix: str = "") -> list[str]:
    """The names in the table of a route below a prefix."""
    if isinstance(route, APIWebSocketRoute):
        return [f"WS {prefix}{route.path}"]
    if isinstance(route, APIRoute):
        return [f"{method} {prefix}{route.path}" for method in sorted(route.methods or ())]
    return [f"{type(route).__name__} {getattr(route, 'path', '?')}"]  # never in the table: it would pass by the door


def check_roles(calls: Iterable[str]) -> None:
    """Raises LocalProtocolError when a call has no role: nothing is open because somebody forgot."""
    missing = [call for call in calls if call not in ROLES]
    if missing:
        raise LocalProtocolError(f"no role is set for {', '.join(missing)}; add it to ROLES in station/api/roles.py")
