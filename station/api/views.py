"""The station's objects as the API's models."""

from __future__ import annotations

import time

import numpy as np

from station.api.models import (
    AppliedModel,
    BatteryModel,
    BinModel,
    CapabilitiesModel,
    ClockModel,
    ComparisonModel,
    CurrentPlace,
    EdgeModel,
    Evidence,
    JobModel,
    LogModel,
    LossesModel,
    MapModel,
    NavigationModel,
    PlaceModel,
    PlaceName,
    PlaceProbability,
    PlacesChangeModel,
    RatesModel,
    ReplayModel,
    RobotEntry,
    RobotModel,
    RouteModel,
    SlamModel,
    VisitModel,
)
from station.events import LogLine
from station.library.bin import BinEntry
from station.library.comparisons import Comparison
from station.library.maps import ActiveMap, Maps, PlacesChange
from station.library.navigation_records import NavigationRecord
from station.model.map_store import MapSummary
from station.model.navigation import Navigation
from station.model.place_map import Place, PlaceEdge, PlaceMap
from station.model.points import NO_PLACE
from station.places.making.graph import Route
from station.places.making.names import has_own_name
from station.robots.places import Visit
from station.robots.session import RobotSession
from station.workers.jobs import Job


def robot_model(robot: RobotSession) -> RobotModel:
    state = robot.state
    hello, status = state.hello, state.status
    able = hello.capabilities if hello else None
    applied = robot.applied
    return RobotModel(
        connected=state.connected,
        reason=state.reason,
        host=state.host,
        port=state.port,
        robot_id=hello.robot_id if hello else None,
        name=hello.name if hello else None,
        capabilities=CapabilitiesModel(
            camera=able.camera,
            imu=able.imu,
            drive=able.drive,
            pan_tilt=able.pan_tilt,
            battery=able.battery,
            hijack=able.hijack,
            max_linear_m_s=able.max_linear_m_s,
            max_angular_rad_s=able.max_angular_rad_s,
        )
        if able
        else None,
        calibrated=hello is not None and hello.calibration.camera is not None,
        connections=state.connections,
        rates=RatesModel(
            frames_hz=round(state.frame_rate_hz, 1),
            imu_hz=round(state.imu_rate_hz, 1),
            bytes_per_s=round(state.received_bytes_per_s),
        ),
        losses=LossesModel(
            frames_skipped=state.frames_skipped,
            imu_gaps=state.imu_gaps,
            imu_lost=state.imu_lost,
            imu_lost_in_sensor=status.imu_lost_in_sensor if status else 0,
        ),
        clock=ClockModel(
            offset_s=None if state.clock_offset_ns is None else state.clock_offset_ns * 1e-9,
            drift_ppm=state.clock_drift_ppm,
            rtt_ms=state.rtt_ms,
        ),
        battery=BatteryModel(voltage_v=status.battery_v, fraction=status.battery_fraction)
        if status and status.battery_v is not None
        else None,
        temperatures_c=dict(status.temperatures_c) if status else {},
        cpu_percent=status.cpu_percent if status else None,
        driver=robot.driving.driver,
        robot_driver=status.driver if status else None,
        applied=AppliedModel(linear=applied.linear, angular=applied.angular) if applied and state.connected else None,
        head_must_rest=robot.head_must_rest,
        faults=list(status.faults) if status else [],
    )


def robot_entry(robot: RobotSession) -> RobotEntry:
    running = robot.recording.running
    here = current_place(robot)
    return RobotEntry(
        name=robot.name,
        path=f"/robots/{robot.name}",
        navigation=None if running is None else running.id,
        state=here.state,
        place=here.place,
        robot=robot_model(robot),
    )


def current_place(robot: RobotSession) -> CurrentPlace:
    """The answer to the question all this is for."""
    report = robot.locating.report
    first = robot.maps.active
    active = None if report is None else robot.maps.among_active(report.map_id)
    # Places may have been renamed, hidden or merged since the answer was made: what they are now counts.
    known = {place.id: (place, one) for one in robot.maps.all_active for place in one.visible_places}
    is_outdated = report is not None and report.answer.place is not None and report.answer.place.id not in known
    if report is None or active is None or is_outdated:
        return CurrentPlace(
            state="unknown",
            place=None,
            probability=0.0,
            distance_m=None,
            position_map=None,
            age_s=None,
            map=first.place_map.id if first else None,
            alternatives=[],
            evidence=Evidence(query_image=None, map_image=None, inliers=0, age_s=None),
            reason=_no_answer_yet(robot),
            preparing=robot.locating.progress if first else None,
            t_robot_ns=None,
            pose_map=None,
        )
    answer, map_id = report.answer, report.map_id
    likeliest = answer.place or (answer.alternatives[0] if answer.alternatives else None)
    is_metric = active.place_map.navigation.is_metric
    evidence_ns, keyframe = answer.evidence_t_robot_ns, answer.evidence_keyframe
    has_query = evidence_ns is not None and robot.locating.query_image(evidence_ns) is not None
    return CurrentPlace(
        state=answer.state,
        place=PlaceName(id=answer.place.id, name=known[answer.place.id][0].name) if answer.place else None,
        probability=_probability(likeliest.probability if likeliest else 0.0),
        distance_m=answer.distance if is_metric else None,
        position_map=None if answer.position_map is None else [float(x) for x in answer.position_map],
        age_s=_age_s(robot, answer.t_robot_ns),
        map=map_id,
        alternatives=[
            PlaceProbability(id=c.id, name=place.name, probability=_probability(c.probability), map=one.place_map.id)
            for c in answer.alternatives
            if c.id in known
            for place, one in [known[c.id]]
        ],
        evidence=Evidence(
            query_image=f"{robot.path}/place/current/images/{evidence_ns}.jpg" if has_query else None,
            map_image=None if keyframe is None else f"/maps/{map_id}/images/{keyframe}.jpg",
            inliers=answer.inliers,
            age_s=None if evidence_ns is None else _age_s(robot, evidence_ns),
        ),
        reason=robot.looks_aside or answer.reason,
        preparing=None,
        t_robot_ns=answer.t_robot_ns,
        pose_map=None if report.T_map_cam is None else [float(x) for x in report.T_map_cam.ravel()],
    )


def _no_answer_yet(robot: RobotSession) -> str:
    if robot.maps.active is None:
        return "no map is active; record a navigation, build a map from it and choose it"
    if not robot.state.connected:
        return "no robot is connected"
    if robot.locating.progress is not None:
        return f"getting the map ready: {robot.locating.status}"
    return robot.looks_aside or f"no picture was looked at yet ({robot.locating.status})"


def _probability(p: float) -> float:
    return min(1.0, max(0.0, p))


def _age_s(robot: RobotSession, t_robot_ns: int) -> float | None:
    t_station_ns = robot.link.to_station_ns(t_robot_ns)
    return None if t_station_ns is None else max(0.0, (time.monotonic_ns() - t_station_ns) * 1e-9)


def visit_model(visit: Visit) -> VisitModel:
    return VisitModel(
        state=visit.state,
        place=None if visit.place_id is None else PlaceName(id=visit.place_id, name=visit.place_name),
        start_unix_s=visit.start_wall_s,
        end_unix_s=visit.end_wall_s,
    )


def place_model(active: ActiveMap, place: Place) -> PlaceModel:
    has_images = place.representative_keyframe >= 0
    return PlaceModel(
        id=place.id,
        name=place.name,
        centroid_map=[float(x) for x in place.centroid_map],
        radius=place.radius,
        landmarks=len(place.landmark_index),
        images=len(place.keyframe_index),
        quality=place.quality,
        representative_image=f"/places/{place.id}/images/representative" if has_images else None,
        mean_image=f"/places/{place.id}/images/mean" if has_images else None,
        deviation_image=f"/places/{place.id}/images/deviation" if has_images else None,
        colour=active.numbers.get(place.id, NO_PLACE),
        hidden=place.hidden,
        named=has_own_name(place.name),
    )


def change_model(change: PlacesChange) -> PlacesChangeModel:
    return PlacesChangeModel(version=change.version, why=change.why, unix_s=change.changed_wall_s)


def edge_model(edge: PlaceEdge) -> EdgeModel:
    return EdgeModel(a=edge.a, b=edge.b, bearing_rad=edge.bearing_rad, distance=edge.distance, kind=edge.kind)


def route_model(place_map: PlaceMap, route: Route) -> RouteModel:
    return RouteModel(
        map=place_map.id,
        metric=place_map.navigation.is_metric,
        places=[PlaceName(id=i, name=name) for i, name in zip(route.place_ids, route.names, strict=True)],
        legs=[edge_model(edge) for edge in route.legs],
        length=route.length,
    )


def map_model(summary: MapSummary, maps: Maps) -> MapModel:
    return MapModel(
        id=summary.id,
        name=summary.name,
        places=summary.places,
        active=maps.among_active(summary.id) is not None,
        first=maps.active is not None and maps.active.place_map.id == summary.id,
        damaged=summary.damaged,
    )


def comparison_model(comparison: Comparison) -> ComparisonModel:
    T = comparison.T_first_second
    return ComparisonModel(
        id=comparison.id,
        name=comparison.name,
        first=comparison.first,
        second=comparison.second,
        made_unix_s=comparison.made_wall_s,
        places=comparison.places,
        locations=comparison.locations,
        matches=comparison.matches,
        accepted=comparison.accepted,
        reasons=list(comparison.reasons),
        T_first_second=None if T is None else [x for row in T for x in row],
        report=f"/comparisons/{comparison.id}/report.html",
    )


def replay_model(navigation_id: str, navigation: Navigation, limit: int) -> ReplayModel:
    times = navigation.trajectory.t_robot_ns
    chosen = np.unique(np.linspace(0, max(len(times) - 1, 0), min(limit, len(times))).round().astype(int))
    camera = navigation.calibration.camera
    T_body_cam = camera.T_body_cam_matrix if camera else np.eye(4)
    start_ns = int(times[0]) if len(times) else 0
    poses = navigation.trajectory.T_world_body[chosen] @ T_body_cam
    return ReplayModel(
        navigation=navigation_id,
        start_ns=start_ns,
        t_s=[(int(t) - start_ns) * 1e-9 for t in times[chosen]],
        T_world_cam=[[round(float(x), 5) for x in T.ravel()] for T in poses],
    )


def bin_model(entry: BinEntry) -> BinModel:
    return BinModel(
        kind=entry.kind,
        id=entry.id,
        name=entry.name,
        deleted_unix_s=entry.deleted_wall_s,
        gone_unix_s=entry.gone_wall_s,
    )


def navigation_model(navigation: NavigationRecord) -> NavigationModel:
    return NavigationModel(
        id=navigation.id,
        name=navigation.name,
        state=navigation.state,
        message=navigation.message,
        robot=navigation.robot,
        started_unix_s=navigation.started_wall_s,
        duration_s=navigation.duration_s,
        backend=navigation.backend,
        frames=navigation.frames,
        frames_skipped=navigation.frames_skipped,
        imu_samples=navigation.imu_samples,
        imu_lost=navigation.imu_lost,
        slam_failures=navigation.slam_failures,
        landmarks=navigation.landmarks,
        scale=navigation.scale,
        recording=None if navigation.state == "recording" else f"/navigations/{navigation.id}/recording.mcap",
    )


def job_model(job: Job) -> JobModel:
    return JobModel(
        id=job.id,
        kind=job.kind,
        title=job.title,
        state=job.state,
        progress=job.progress,
        message=job.message,
        result=job.result,
    )


def slam_model(robot: RobotSession) -> SlamModel:
    live = robot.recording.live
    if live is None:
        return SlamModel(
            navigation=None,
            state="none",
            message="SLAM does not run: record a navigation",
            landmarks=0,
            frames=0,
            t_robot_ns=None,
            T_world_body=None,
            T_world_cam=None,
            segment=0,
        )
    pose = live.pose
    hello = robot.state.hello
    camera = hello.calibration.camera if hello else None
    T_body_cam = camera.T_body_cam_matrix if camera else np.eye(4)
    is_running = robot.recording.running is not None and robot.recording.running.id == live.navigation_id
    left_to_do = robot.recording.left_to_do
    return SlamModel(
        navigation=live.navigation_id,
        state=(live.state or "initialising") if is_running else "finishing" if left_to_do else "finished",
        message=left_to_do or live.message,
        landmarks=live.num_landmarks,
        frames=live.frames,
        t_robot_ns=pose.t_robot_ns if pose else None,
        T_world_body=[float(x) for x in pose.T_world_body.ravel()] if pose else None,
        T_world_cam=[float(x) for x in (pose.T_world_body @ T_body_cam).ravel()] if pose else None,
        segment=pose.segment if pose else 0,
    )


def log_model(line: LogLine) -> LogModel:
    return LogModel(number=line.number, unix_s=line.t_wall_s, level=line.level, topic=line.topic, text=line.text)
