"""Lines to draw a floor plan with: what surrounds each room, and where the robot drove."""

from __future__ import annotations

import cv2
import numpy as np

from shared.geometry import FloatArray
from station.model.floor_plan import FloorPlan
from station.model.navigation import Navigation
from station.places.making.scale import units_per_metre

SMOOTH_CELLS = 1.5  # an outline follows its cells this closely: stairs of cells become straight lines
HOLE_M2 = 0.5  # a smaller spot that is not free is a piece of furniture, not drawn
STEP_M = 0.1  # between points of a path
MAX_POINTS = 5000


def room_outlines(plan: FloorPlan) -> list[list[FloatArray]]:
    """For each room its closed lines, (n, 2) each on the ground: what is inside an odd number of them is the room."""
    return [_outline(plan, number) for number in range(len(plan.rooms))]


def _outline(plan: FloorPlan, number: int) -> list[FloatArray]:
    rows, columns = np.nonzero(plan.room == number)
    if not len(rows):
        return []
    first = np.array([rows.min(), columns.min()])
    mask = np.zeros((np.ptp(rows) + 1, np.ptp(columns) + 1), dtype=np.uint8)
    mask[rows - first[0], columns - first[1]] = 1
    lines, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outline = []
    for line, (_, _, _, parent) in zip(lines, hierarchy[0], strict=True):
        is_hole = parent >= 0
        if is_hole and cv2.contourArea(line) * plan.cell**2 < HOLE_M2 * plan.unit**2:
            continue
        smooth = cv2.approxPolyDP(line, SMOOTH_CELLS, True)[:, 0, ::-1]
        if len(smooth) > 2:
            outline.append(plan.low + (smooth + first + 0.5) * plan.cell)
    return outline


def driven_path(navigation: Navigation, R_ground_map: FloatArray) -> FloatArray:
    """(n, 2) where the body was, on the ground, in time order; a few points for each metre."""
    p = navigation.trajectory.T_world_body[:, :3, 3]
    p = (p[np.isfinite(p).all(axis=1)] @ R_ground_map.T)[:, :2]
    if not len(p):
        return p
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    steps = min(int(travelled[-1] / (STEP_M * units_per_metre(navigation))) + 2, MAX_POINTS)
    return p[np.unique(np.searchsorted(travelled, np.linspace(0, travelled[-1], steps)).clip(0, len(p) - 1))]
