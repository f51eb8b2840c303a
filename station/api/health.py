"""/healthz and /metrics."""

from __future__ import annotations

import time
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

from fastapi import APIRouter, Response
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric

from station.api.deps import StationDep
from station.api.models import HealthModel
from station.app import Station

router = APIRouter(tags=["health"])
TEXT_FORMAT = "text/plain; version=0.0.4; charset=utf-8"


@router.get("/healthz", summary="The station is up")
async def healthz(station: StationDep) -> HealthModel:
    return HealthModel(
        status="ok",
        version=program_version(),
        uptime_s=time.monotonic() - station.started_s,
        robot_connected=station.robot.connected,
        localisation=station.locating.status,
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
    try:
        return version("sentinel-robot")
    except PackageNotFoundError:
        return "0 (not installed)"


class _StationCollector:
    """Reads the station's own counts when asked; nothing is counted twice."""

    def __init__(self, station: Station) -> None:
        self._station = station

    def collect(self) -> Iterable[Metric]:
        station, link = self._station, self._station.robot
        live, report = station.drives.live, station.locating.report
        gauges: dict[str, tuple[str, float | None]] = {
            "robot_connected": ("1 while the robot is connected", float(link.connected)),
            "frame_rate_hz": ("camera frames per second", link.frame_rate_hz),
            "imu_rate_hz": ("inertial samples per second", link.imu_rate_hz),
            "link_rtt_seconds": ("round trip", None if link.rtt_ms is None else link.rtt_ms / 1e3),
            "clock_drift_ppm": ("robot's clock against ours", link.clock_drift_ppm),
            "battery_volts": ("supply of the motors", link.status.battery_v if link.status else None),
            "slam_landmarks": ("of the running navigation", float(live.num_landmarks) if live else None),
            "place_known": (
                "1 while the current place is known",
                float(report.answer.state == "known") if report else 0,
            ),
            "camera_viewers": ("who watch the video", float(station.camera.num_readers)),
            "event_readers": ("who listen to events", float(station.events.hub.num_readers)),
        }
        counters: dict[str, tuple[str, float]] = {
            "frames": ("camera frames received", link.frames),
            "frames_skipped": ("frames the link had no time for", link.frames_skipped),
            "imu_samples": ("inertial samples received", link.imu_samples),
            "imu_lost": ("inertial samples lost", link.imu_lost),
            "connections": ("connections to the robot", link.connections),
            "place_answers": ("pictures answered by localisation", station.locating.answers),
        }
        for name, (text, value) in gauges.items():
            if value is not None:
                yield GaugeMetricFamily(f"sentinel_{name}", text, value=value)
        for name, (text, count) in counters.items():
            yield CounterMetricFamily(f"sentinel_{name}", text, value=count)
