"""Printed words in pictures, read by rapidocr: the only module that knows it."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

import numpy as np

from shared.geometry import FloatArray
from station.model.frames import ImageArray

MIN_SCORE = 0.9  # the best false glyph of nearby plates was at 0.71; of small print a fifth is misread at this


@dataclass(frozen=True, slots=True, eq=False)
class PrintedLine:
    """One line of text in one picture."""

    text: str
    score: float  # 0..1 of the reader
    corners_px: FloatArray  # (4, 2) top left, top right, bottom right, bottom left as one reads


def can_read_print() -> bool:
    """Whether the extra `ocr` is installed."""
    return all(importlib.util.find_spec(name) is not None for name in ("rapidocr", "onnxruntime"))


class PrintReader:
    """Reads lines of text. 0.2 s of one core a picture of 640 x 480."""

    def __init__(self) -> None:
        """Loads models: half a second. They lie in the package, nothing is fetched."""
        from rapidocr import RapidOCR

        self._read = RapidOCR(
            params={
                "Global.log_level": "critical",  # it warns of every picture without text
                "Global.use_cls": False,  # no text hangs upside down
                "EngineConfig.onnxruntime.intra_op_num_threads": 1,  # jobs have one core
                "EngineConfig.onnxruntime.inter_op_num_threads": 1,
            }
        )

    def __call__(self, bgr: ImageArray) -> list[PrintedLine]:
        """What is surely read in a picture (H, W, 3)."""
        found = self._read(bgr, text_score=MIN_SCORE)
        if found.boxes is None or found.txts is None or found.scores is None:
            return []
        return [
            PrintedLine(" ".join(text.split()), float(score), np.asarray(corners, dtype=np.float64))
            for corners, text, score in zip(found.boxes, found.txts, found.scores, strict=True)
        ]
