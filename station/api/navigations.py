"""/navigations and /jobs."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Body
from fastapi.responses import FileResponse

from shared.bounded import shown
from station.api.deps import RobotDep, StationDep
from station.api.problems import responses
from station.api.schema.base import NewName
from station.api.schema.jobs import JobModel
from station.api.schema.navigations import BinModel, NavigationModel, NavigationStart, bin_model, navigation_model
from station.errors import Conflict, Unknown

router = APIRouter(tags=["navigations"])
of_robot = APIRouter(tags=["navigations"])
DOWNLOADS = {"trajectory.tum": "text/plain", "landmarks.ply": "application/octet-stream"}


@router.get("/navigations", summary="Recorded navigations, oldest first")
async def navigations(station: StationDep) -> list[NavigationModel]:
    return [navigation_model(navigation) for navigation in station.navigations.list()]


@of_robot.post("/navigations", summary="Start recording, with SLAM", status_code=201, responses=responses(409, 503))
async def start(robot: RobotDep, order: Annotated[NavigationStart | None, Body()] = None) -> NavigationModel:
    return navigation_model(await robot.start_navigation(order.name if order else ""))


@router.get("/navigations/{navigation_id}", summary="One navigation", responses=responses(404))
async def navigation(navigation_id: str, station: StationDep) -> NavigationModel:
    return navigation_model(station.navigations.get(navigation_id))


@router.patch("/navigations/{navigation_id}", summary="Rename a navigation", responses=responses(404, 409))
async def rename(navigation_id: str, name: NewName, station: StationDep) -> NavigationModel:
    return navigation_model(await station.navigations.rename(navigation_id, name.name))


@router.post("/navigations/{navigation_id}/stop", summary="End recording", responses=responses(404, 409))
async def stop(navigation_id: str, station: StationDep) -> NavigationModel:
    """SLAM finishes in the background: the state goes from "finishing" to "ready" or "failed"."""
    return navigation_model(await station.stop_navigation(navigation_id))


@router.post("/navigations/{navigation_id}/cancel", summary="Give up finishing", responses=responses(404, 409))
async def cancel_finishing(navigation_id: str, station: StationDep) -> NavigationModel:
    """While SLAM finishes; the state goes to "failed". The recording stays, and can be processed again.

    409 when there is nothing to cancel: the navigation is still being recorded, or SLAM has ended.
    """
    return navigation_model(station.cancel_navigation(navigation_id))


@router.delete(
    "/navigations/{navigation_id}",
    summary="Delete a navigation",
    status_code=204,
    responses=responses(404, 409),
)
async def delete(navigation_id: str, station: StationDep) -> None:
    """It goes into the bin: POST /navigations/{id}/restore brings it back for seven days."""
    await station.delete_navigation(navigation_id)


@router.post(
    "/navigations/{navigation_id}/restore", summary="Bring a deleted navigation back", responses=responses(404, 409)
)
async def restore(navigation_id: str, station: StationDep) -> NavigationModel:
    return navigation_model(await station.restore_navigation(navigation_id))


@router.get("/bin", summary="What was deleted and can be restored", tags=["bin"])
async def deleted(station: StationDep) -> list[BinModel]:
    """The newest first. Kept for seven days, and no more than twenty things."""
    return [bin_model(entry) for entry in station.bin.list()]


@router.delete("/bin", summary="Delete for good", status_code=204, tags=["bin"], responses=responses(409))
async def empty_bin(station: StationDep) -> None:
    await station.empty_bin(everything=True)


@router.get(
    "/navigations/{navigation_id}/{name}",
    summary="Download recording.mcap, trajectory.tum or landmarks.ply",
    response_class=FileResponse,
    responses=responses(404, 409),
)
async def download(navigation_id: str, name: str, station: StationDep) -> FileResponse:
    navigation = station.navigations.library.get(navigation_id)
    folder = station.navigations.library.folder(navigation_id)
    if name == "recording.mcap":
        path = folder / name
    elif name in DOWNLOADS:
        path = folder / "navigation" / name
    else:
        raise Unknown(f"there is no file {shown(name)}; recording.mcap, {' and '.join(DOWNLOADS)} can be downloaded")
    if navigation.state == "recording" or not path.is_file():
        raise Conflict(f"{navigation.name} has no {name} now (it is {navigation.state})")
    kind = DOWNLOADS.get(name, "application/octet-stream")
    return FileResponse(path, media_type=kind, filename=f"{navigation_id}-{name}")


@router.get("/jobs", summary="Work in the background", tags=["jobs"])
async def jobs(station: StationDep) -> list[JobModel]:
    return [JobModel.of(job) for job in station.jobs.list()]


@router.get("/jobs/{job_id}", summary="One job", tags=["jobs"], responses=responses(404))
async def job(job_id: str, station: StationDep) -> JobModel:
    return JobModel.of(station.jobs.get(job_id))


@router.delete("/jobs/{job_id}", summary="Cancel a job", tags=["jobs"], responses=responses(404, 409))
async def cancel(job_id: str, station: StationDep) -> JobModel:
    """409 when it was over before it could be cancelled: what it made is there."""
    return JobModel.of(await station.jobs.cancel(job_id))
