"""/comparisons: two navigations, matched; the same report as `station experiment` writes."""

from __future__ import annotations

import asyncio
from typing import Literal

from fastapi import APIRouter
from fastapi.responses import FileResponse

from station.api.deps import StationDep
from station.api.problems import responses
from station.api.schema.comparisons import ComparisonModel, ComparisonOrder, comparison_model
from station.api.schema.jobs import JobModel
from station.library.comparisons import FILES

router = APIRouter(tags=["comparisons"])
# The report is one file without scripts; nothing in it may ask another host.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
REPORT = {
    "description": "the report, or its numbers",
    "content": {"text/html": {"schema": {"type": "string"}}, "application/json": {"schema": {"type": "object"}}},
}


@router.get("/comparisons", summary="All comparisons, the newest first")
async def comparisons(station: StationDep) -> list[ComparisonModel]:
    found = await asyncio.to_thread(station.comparisons.list)
    return [comparison_model(comparison) for comparison in found]


@router.post("/comparisons", summary="Compare two navigations", status_code=202, responses=responses(404, 409))
async def compare(order: ComparisonOrder, station: StationDep) -> JobModel:
    """Runs in the background: follow GET /jobs/{id}, whose result names the comparison; DELETE /jobs/{id} cancels."""
    return JobModel.of(station.compare(order.first, order.second))


@router.get("/comparisons/{comparison_id}", summary="One comparison", responses=responses(404))
async def comparison(comparison_id: str, station: StationDep) -> ComparisonModel:
    return comparison_model(await asyncio.to_thread(station.comparisons.get, comparison_id))


@router.delete("/comparisons/{comparison_id}", summary="Delete a comparison", status_code=204, responses=responses(404))
async def delete(comparison_id: str, station: StationDep) -> None:
    """For good: the navigations are still there, and can be compared again."""
    await asyncio.to_thread(station.comparisons.delete, comparison_id)


@router.get(
    "/comparisons/{comparison_id}/{name}",
    summary="The report to look at, or its numbers",
    response_class=FileResponse,
    responses={200: REPORT, **responses(404)},
)
async def file(comparison_id: str, name: Literal["report.html", "results.json"], station: StationDep) -> FileResponse:
    path = await asyncio.to_thread(station.comparisons.file, comparison_id, name)
    headers = {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff"}
    return FileResponse(path, media_type=FILES[name], headers=headers)
