"""One picture of a world: its floor plan with the mapping route, and views from each room's middle."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from robot.simulation.body import PoseFunction
from robot.simulation.config import SimulationConfig
from robot.simulation.construction import built_camera
from robot.simulation.imaging import SimulatedCamera
from robot.simulation.renderer import Renderer
from robot.simulation.routes import Route, plan_route
from robot.simulation.texture_strokes import ImageArray
from robot.simulation.world import World
from shared.calibration import REFERENCE_CAMERA
from shared.errors import DataError
from shared.geometry import FloatArray, se3, yaw_rotation

VIEW_PX = (360, 270)
VIEWS_PER_ROOM = 6
PLAN_PX_PER_M = 110


def draw_contact_sheet(world: World, config: SimulationConfig, out: Path, cache_dir: Path | None) -> None:
    """Write the sheet. Raises DataError when the file cannot be written."""
    built = built_camera(REFERENCE_CAMERA, config.build)
    camera = SimulatedCamera(Renderer(world, built, cache_dir), built, config.camera, 0)
    rows = []
    for room in world.rooms:
        views = []
        for k in range(VIEWS_PER_ROOM):
            T = se3(yaw_rotation(2 * math.pi * k / VIEWS_PER_ROOM), np.array([*room.centre, config.body.imu_height_m]))
            image = camera.expose(_constant(T), 0.0, config.faults).image
            views.append(cv2.resize(image, VIEW_PX, interpolation=cv2.INTER_AREA))
        cv2.putText(views[0], room.name, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2, cv2.LINE_AA)
        rows.append(np.hstack(views))
    plan = draw_plan(world, plan_route(world, "mapping", 0, config.body.radius_m))
    width = rows[0].shape[1]
    canvas = np.full((plan.shape[0], width, 3), 255, np.uint8)
    canvas[:, : min(width, plan.shape[1])] = plan[:, :width]
    if not cv2.imwrite(str(out), np.vstack([*rows, canvas])):
        raise DataError(f"{out} cannot be written; choose another --out ending in .png")


def _constant(T: FloatArray) -> PoseFunction:
    return lambda _t: T


def draw_plan(world: World, route: Route | None = None) -> ImageArray:
    """The floor plan from above, north up."""
    x0, y0, x1, y1 = world.bounds()
    scale, edge = PLAN_PX_PER_M, 30

    def px(points: FloatArray) -> FloatArray:
        q = (np.asarray(points) - (x0, y0)) * scale + edge
        q[:, 1] = (y1 - y0) * scale + 2 * edge - q[:, 1]
        return np.round(q).astype(np.int32)

    image = np.full((round((y1 - y0) * scale) + 2 * edge, round((x1 - x0) * scale) + 2 * edge, 3), 255, np.uint8)
    for o in world.obstacles:
        c, s = math.cos(o.yaw_rad), math.sin(o.yaw_rad)
        local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (o.half_x_m, o.half_y_m)
        corners = local @ np.array([[c, s], [-s, c]]) + (o.x_m, o.y_m)
        colour = (60, 60, 60) if o.name == "wall" else (205, 190, 170)
        cv2.fillPoly(image, [px(corners)], colour)
        if o.name != "wall":
            at = px(np.array([[o.x_m, o.y_m]]))[0]
            cv2.putText(image, o.name, (at[0] - 25, at[1] + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.33, (40, 40, 40), 1)
    for room in world.rooms:
        at = px(np.array([room.centre]))[0]
        cv2.putText(image, room.name, (at[0] - 40, at[1]), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (160, 60, 0), 1, cv2.LINE_AA)
    if route is not None:
        cv2.polylines(image, [px(route.points)], False, (60, 60, 220), 2, cv2.LINE_AA)
        cv2.circle(image, px(route.points[:1])[0].tolist(), 6, (60, 160, 60), -1, cv2.LINE_AA)
    return image
