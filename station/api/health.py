"""/healthz and /metrics."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from fastapi import APIRouter, Response
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric

from station.api.deps import StationDep
from station.api.schema.station import HealthModel
from station.app import Station
from station.robots.session import RobotSession

router = APIRouter(tags=["health"])
TEXT_FORMAT = "text/plain; version=0.0.4; charset=utf-8"


@router.get("/healthz", summary="The station is up")
async def healthz(station: StationDep) -> HealthModel:
    return HealthModel(
        status="ok",
        version=program_version(),
        uptime_s=time.monotonic() - station.started_s,
        robot_connected=station.first.state.connected,
        localisation=station.first.current_place.status,
    )


@router.get(
    "/metrics",
    summary="Counters for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}, "description": "Prometheus text format"}},
)
async def metrics(station: StationDep) -> Response:
    registry = CollectorRegistry()
    registry.register(_StationCollector(station))
    return Response(generate_latest(registry), media_type=TEXT_FORMAT)


def program_version() -> str:
    """Of the installed package; in a folder of sources that nobody installed, of these."""
    try:
        return version("sentinel-robot")
    except PackageNotFoundError:
        sources = Path(__file__).parents[2] / "pyproject.toml"
        return str(tomllib.loads(sources.read_text())["project"]["version"]) if sources.is_file() else "unknown"


class _StationCollector:
    """Reads the station's own counts when asked; nothing is counted twice."""

    def __init__(self, station: Station) -> None:
        self._station = station

    def collect(self) -> Iterable[Metric]:
        """One robot: as ever. Several: each series carries the robot's name."""
        robots = list(self._station.robots.values())
        labels = ["robot"] if len(robots) > 1 else []
        families: dict[str, GaugeMetricFamily | CounterMetricFamily] = {}
        for robot in robots:
            names = [robot.name] if labels else []
            for make, values in ((GaugeMetricFamily, _gauges(robot)), (CounterMetricFamily, _counters(robot))):
                for name, (text, value) in values.items():
                    family = families.setdefault(name, make(f"sentinel_{name}", text, labels=labels))
                    if value is not None:
                        family.add_metric(names, value)
        yield from (family for family in families.values() if family.samples)


def _gauges(robot: RobotSession) -> dict[str, tuple[str, float | None]]:
    link, live, report = robot.state, robot.current_navigation.live, robot.current_place.report
    return {
        "robot_connected": ("1 while the robot is connected", float(link.connected)),
        "frame_rate_hz": ("camera frames per second", link.frame_rate_hz),
        "imu_rate_hz": ("inertial samples per second", link.imu_rate_hz),
        "link_rtt_seconds": ("round trip", None if link.rtt_ms is None else link.rtt_ms / 1e3),
        "clock_drift_ppm": ("robot's clock against ours", link.clock_drift_ppm),
        "battery_volts": ("supply of the motors", link.status.battery_v if link.status else None),
        "slam_landmarks": ("of the running navigation", float(live.num_landmarks) if live else None),
        "place_known": ("1 while the current place is known", float(report.answer.state == "known") if report else 0),
        "camera_viewers": ("who watch the video", float(robot.camera.num_readers)),
        "event_readers": ("who listen to events", float(robot.events.hub.num_readers)),
    }


def _counters(robot: RobotSession) -> dict[str, tuple[str, float | None]]:
    link = robot.state
    return {
        "frames": ("camera frames received", link.frames),
        "frames_skipped": ("frames the link had no time for", link.frames_skipped),
        "imu_samples": ("inertial samples received", link.imu_samples),
        "imu_lost": ("inertial samples lost", link.imu_lost),
        "connections": ("connections to the robot", link.connections),
        "place_answers": ("pictures answered by localisation", robot.current_place.answers),
    }
