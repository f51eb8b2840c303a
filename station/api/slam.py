"""/pose, /trajectory, /landmarks: the running SLAM."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Response

from station.api.deps import RobotDep
from station.api.points import BINARY, WantsPly, ply_response, points_response
from station.api.problems import responses
from station.api.schema.slam import SlamModel, TrajectoryModel, slam_model
from station.errors import Conflict
from station.files.navigation_folder import format_tum
from station.model.points import pack_points
from station.robots.live_slam import LivePath, LiveSlam
from station.robots.session import RobotSession

of_robot = APIRouter(tags=["SLAM"])


@of_robot.get("/pose", summary="The newest pose, and how SLAM is")
async def pose(robot: RobotDep) -> SlamModel:
    return slam_model(robot)


@of_robot.get(
    "/trajectory",
    summary="The way so far",
    response_model=TrajectoryModel,
    responses={200: {"content": {"text/plain": {}}}},
)
async def trajectory(
    robot: RobotDep,
    limit: Annotated[int, Query(ge=2, le=20_000, description="thinned out evenly to this many")] = 2000,
    format: Annotated[Literal["json", "tum"], Query()] = "json",
) -> TrajectoryModel | Response:
    live = robot.current_navigation.live
    way = (LivePath(1) if live is None else live.path).trajectory()
    if format == "tum":
        text = await asyncio.to_thread(format_tum, way)
        return Response(text, media_type="text/plain")
    chosen: list[int] = (
        np.unique(np.linspace(0, len(way) - 1, min(limit, len(way))).round().astype(int)).tolist() if len(way) else []
    )
    return TrajectoryModel(
        navigation=live.navigation_id if live else None,
        source=live.source if live else None,
        total=live.path.num_seen if live else 0,
        t_robot_ns=way.t_robot_ns[chosen].tolist(),
        p_world=way.T_world_body[chosen, :3, 3].round(4).tolist(),
    )


@of_robot.get(
    "/landmarks",
    summary="Landmarks so far, binary or PLY",
    response_class=Response,
    responses={200: BINARY, **responses(409)},
)
async def landmarks(
    robot: RobotDep,
    since: Annotated[int, Query(ge=0, description="number of the first one wanted: the total of the last answer")] = 0,
    navigation: Annotated[str, Query(description="X-Source of that answer; of another cloud all points come")] = "",
    is_ply: WantsPly = False,
) -> Response:
    """As PLY: 409 while there are none, since an empty file helps nobody."""
    live = robot.current_navigation.live
    if live is None:
        live = LiveSlam("")
    first = 0 if navigation and navigation != live.source else min(since, len(live.points))
    p, rgb = live.points.since(first)
    total = first + len(p)
    if not is_ply:
        return points_response(await asyncio.to_thread(pack_points, p, rgb), first, total, live.source)
    if not total:
        raise Conflict(_no_points(robot))
    return await ply_response(p, rgb, live.source, "landmarks")


def _no_points(robot: RobotSession) -> str:
    active = robot.active_maps.first
    if robot.current_navigation.running is not None:
        return "the navigation that is recorded has no landmarks yet; most come when it is finished"
    elsewhere = "those of a finished one are at /navigations/ID/landmarks?format=ply"
    if active is not None:
        elsewhere = f"the map's are at /maps/{active.place_map.id}/landmarks?format=ply, {elsewhere}"
    return f"no navigation was recorded since the station started, so there are no landmarks of one; {elsewhere}"
