"""A network that somebody supplies as an ONNX file: a picture in, one array out. No other module runs such files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from shared.advice import install
from shared.errors import DataError
from shared.geometry import FloatArray
from shared.text import MAX_EXPLANATION, printable
from station.model.frames import ImageArray

MAX_MODEL_BYTES = 2**31  # no ONNX file has more: a protobuf message cannot
MAX_SIDE_PX = 2048  # of its input: 50 MB as floats
MAX_OUTPUTS = 10_000_000  # numbers; a detector of 80 classes has 7 million at 2048 px, one of 365 at 640 px three

Pixels = Literal["clip", "unit", "imagenet"]
# Mean and standard deviation of red, green and blue in 0..1 that are taken out.
_NORMALISED: dict[Pixels, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "clip": ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)),  # Radford et al., 2021
    "unit": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    "imagenet": ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
}


class ImageModel:
    """Runs on one core."""

    def __init__(self, path: Path, pixels: Pixels, side: int | None = None) -> None:
        """`side`: of the square that it sees, px, where the file leaves that open.

        Raises:
            DataError: onnxruntime is missing or does not load, or the file is none that it can run on a picture.
        """
        self.path = path
        self._session = _open(path)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if len(inputs) != 1:
            raise DataError(f"{path} has {len(inputs)} inputs; give a model of which a picture is the only one")
        self._input, self._output = inputs[0].name, outputs[0].name
        if inputs[0].type not in ("tensor(float)", "tensor(float16)"):
            raise DataError(f"{path} takes {inputs[0].type}; export it for pictures as floats")
        self._dtype = np.float32 if inputs[0].type == "tensor(float)" else np.float16
        self._channels_first, self.side = _picture_input(path, inputs[0].shape, side)
        self._is_whole = len(outputs[0].shape or ()) == 3  # boxes are found near the borders, too
        mean, deviation = _NORMALISED[pixels]
        self._mean, self._deviation = np.array(mean, dtype=np.float32), np.array(deviation, dtype=np.float32)

    def __call__(self, bgr: ImageArray) -> FloatArray:
        """Its first output, without the batch's axis, of a picture (H, W, 3).

        Raises DataError where it cannot be run on a picture or answers with what is no number.
        """
        try:
            (answer,) = self._session.run([self._output], {self._input: self._prepared(bgr)})
        except _failures() as exc:
            raise DataError(f"{self.path} cannot be run on a picture of {self.side} px: {_first_line(exc)}") from exc
        if not isinstance(answer, np.ndarray) or answer.ndim < 2 or answer.shape[0] != 1:
            raise DataError(f"{self.path} answers with {_described(answer)}; its first output must be of one picture")
        if answer.dtype.kind not in "fiu":
            raise DataError(f"{self.path} answers with {answer.dtype}; its first output must be numbers")
        if answer.size > MAX_OUTPUTS:
            raise DataError(
                f"{self.path} answers with {answer.size} numbers, more than the {MAX_OUTPUTS} that are read; export it "
                "for smaller pictures, or give a smaller --size"
            )
        found = answer[0].astype(np.float64)
        if not np.isfinite(found).all():
            raise DataError(f"{self.path} answers with numbers that are none; are --pixels and the file right?")
        return found

    def _prepared(self, bgr: ImageArray) -> npt.NDArray[np.float16 | np.float32]:
        """(1, 3, side, side) or (1, side, side, 3): the middle square of a picture, or for boxes the whole on grey."""
        fit = max if self._is_whole else min
        scale = self.side / fit(bgr.shape[:2])
        width, height = (max(1, round(n * scale)) for n in bgr.shape[1::-1])
        sized = cv2.resize(bgr, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        top, left = (max(0, (n - self.side) // 2) for n in (height, width))
        cut = sized[top : top + self.side, left : left + self.side]
        square = np.full((self.side, self.side, 3), 114, dtype=np.uint8)  # YOLO's grey
        top, left = ((self.side - n) // 2 for n in cut.shape[:2])
        square[top : top + cut.shape[0], left : left + cut.shape[1]] = cut
        rgb = (square[..., ::-1].astype(np.float32) / 255 - self._mean) / self._deviation
        batch = rgb.transpose(2, 0, 1)[None] if self._channels_first else rgb[None]
        return np.ascontiguousarray(batch, dtype=self._dtype)


def _open(path: Path) -> Any:
    """An onnxruntime.InferenceSession. Raises DataError."""
    try:
        import onnxruntime
    except ImportError as exc:  # it is not there, or not for this processor
        raise DataError(f"{path} needs onnxruntime ({_first_line(exc)}): {install('labels')}") from exc
    try:
        if not path.is_file():
            raise DataError(f"{path} is no file; give a model, an .onnx")
        if path.stat().st_size > MAX_MODEL_BYTES:
            raise DataError(f"{path} is larger than an ONNX file can be ({MAX_MODEL_BYTES / 1e9:.1f} GB)")
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a model, an .onnx") from exc
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what fails is said below
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except _failures() as exc:
        raise DataError(f"{path} is no ONNX file that onnxruntime can run: {_first_line(exc)}") from exc


def _picture_input(path: Path, shape: list[int | str | None], side: int | None) -> tuple[bool, int]:
    """Whether the channels come first, and the side of the square, px. Raises DataError."""
    told = f"{path} takes an input of shape {_shape(shape)}"
    takes_one = shape[:1] == [1] or not isinstance(shape[0] if shape else 0, int)  # or as many as one likes
    if len(shape) != 4 or 3 not in (shape[1], shape[3]) or not takes_one:
        raise DataError(f"{told}; a model of single colour pictures takes 1 x 3 x H x W or 1 x H x W x 3")
    channels_first = shape[1] == 3
    height, width = shape[2:4] if channels_first else shape[1:3]
    fixed = {n for n in (height, width) if isinstance(n, int)}
    if len(fixed) == 2:
        raise DataError(f"{told}; export it for square pictures")
    own = next(iter(fixed), None)
    if own is not None and side not in (None, own):
        raise DataError(f"{told}; leave --size {side} out")
    wanted = own or side
    if wanted is None:
        raise DataError(
            f"{told}, which leaves the size open; give --size, in pixels (224 and 256 are usual, 640 for YOLO)"
        )
    if not 16 <= wanted <= MAX_SIDE_PX:
        raise DataError(f"{path}: pictures of {wanted} px a side are not supported; 16 to {MAX_SIDE_PX} px are")
    return channels_first, wanted


def _failures() -> tuple[type[Exception], ...]:
    """All that onnxruntime raises: its exceptions have no common base."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    return tuple(e for e in vars(state).values() if isinstance(e, type) and issubclass(e, Exception))


def _first_line(exc: Exception) -> str:
    return printable((str(exc).splitlines() or [""])[0])[:MAX_EXPLANATION]


def _described(answer: object) -> str:
    return f"an array of {_shape(list(answer.shape))}" if isinstance(answer, np.ndarray) else type(answer).__name__


def _shape(shape: Sequence[object]) -> str:
    return " x ".join("?" if n is None else printable(str(n)) for n in shape) or "no axes"
