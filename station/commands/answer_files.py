"""The files that `station locate` and `station replay` write about answers of the current place."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from station.experiments.answers import JudgedAnswers
from station.model.place_answer import PlaceAnswer
from station.workers.replay import answer_lines

ANSWERS, SUMMARY = "answers.jsonl", "summary.json"


def write_answers(answers: Sequence[PlaceAnswer], judged: JudgedAnswers | None, folder: Path) -> None:
    """The answers, a line each; and the judgement, where there is truth to judge by."""
    (folder / ANSWERS).write_text(answer_lines(answers))
    if judged is not None:
        (folder / SUMMARY).write_text(json.dumps(judged.summary(), indent=1) + "\n")
