"""Asks every documented call of a station many times with right and wrong values, and judges each answer.

    python -m benchmarks.bench_openapi [--examples 100] [--seed 1]

No 5xx but a documented refusal, no answer that the document does not have, no wrong value taken for a right one.
Exit code 0 when nothing was found.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.result import Figure, Run, add_results_option
from tests.support.openapi import ask_everything, furnish
from tests.support.station_at_work import at_work


async def run(examples: int, seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as data:
        place_map, known = furnish(Path(data))
        async with at_work(Path(data)) as (desk, _, _):
            await desk.http.put("/maps/active", json={"id": place_map.id})
            begun = time.monotonic()
            asked = await asyncio.to_thread(ask_everything, desk.address, known, examples, seed)
    total: Counter[int] = sum(asked.statuses.values(), Counter())
    return {
        "seed": seed,
        "calls": len(asked.statuses),
        "questions": total.total(),
        "answers": {str(status): count for status, count in sorted(total.items())},
        "found": asked.wrong,
        "seconds": round(time.monotonic() - begun),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=100, help="of right and of wrong values, each, per call")
    parser.add_argument("--seed", type=int, default=1)
    add_results_option(parser, "openapi")
    options = parser.parse_args()
    this_run = Run.begin()
    result = asyncio.run(run(options.examples, options.seed))
    print(json.dumps(result, indent=1))
    what = f"answers that break the API's document, of {result['calls']} calls with right and wrong values"
    this_run.write(options.results, [Figure(what, len(result["found"]), at_most=0, of=result["questions"])])
    sys.exit(1 if result["found"] else 0)


if __name__ == "__main__":
    main()
