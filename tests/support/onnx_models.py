"""Networks of a few numbers, as ONNX files: what they see in a picture is its mean colour, red to blue in 0 to 1."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from onnx import GraphProto, NodeProto, TensorProto, checker, helper, numpy_helper, save_model

SIDE_PX = 32


def save_colour_embedding(path: Path, shape: Sequence[int | str] = (1, 3, SIDE_PX, SIDE_PX)) -> Path:
    """Like CLIP's image encoder: (1, 3), the mean colour."""
    return _save(path, shape, _mean_colour("answer"), [1, 3])


def save_colour_classifier(path: Path, logits: Sequence[Sequence[float]]) -> Path:
    """(1, K) logits: the mean colour times a matrix (3, K)."""
    matrix = numpy_helper.from_array(np.array(logits, dtype=np.float32), "matrix")
    nodes = [*_mean_colour("colour"), helper.make_node("MatMul", ["colour", "matrix"], ["answer"])]
    return _save(path, (1, 3, SIDE_PX, SIDE_PX), nodes, [1, len(logits[0])], [matrix])


def save_colour_detector(path: Path) -> Path:
    """(1, 4 + 3, 1), as YOLOv8 exports: a box, and for each colour how much of it there is."""
    constants = [
        numpy_helper.from_array(np.full((1, 4, 1), 16, dtype=np.float32), "box"),
        numpy_helper.from_array(np.array([1, 3, 1]), "column"),
    ]
    nodes = [
        *_mean_colour("colour"),
        helper.make_node("Reshape", ["colour", "column"], ["scores"]),
        helper.make_node("Concat", ["box", "scores"], ["answer"], axis=1),
    ]
    return _save(path, (1, 3, SIDE_PX, SIDE_PX), nodes, [1, 7, 1], constants)


def save_text_answer(path: Path) -> Path:
    """(1, 3) texts, as classifiers of scikit-learn answer with: the mean colour in writing."""
    nodes = [*_mean_colour("colour"), helper.make_node("Cast", ["colour"], ["answer"], to=TensorProto.STRING)]
    return _save(path, (1, 3, SIDE_PX, SIDE_PX), nodes, [1, 3], kind=TensorProto.STRING)


def _mean_colour(name: str) -> list[NodeProto]:
    return [
        helper.make_node("GlobalAveragePool", ["picture"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], [name]),
    ]


def _save(
    path: Path,
    shape: Sequence[int | str],
    nodes: list[NodeProto],
    answer: list[int],
    constants: Sequence[TensorProto] = (),
    kind: int = TensorProto.FLOAT,
) -> Path:
    graph: GraphProto = helper.make_graph(
        nodes,
        "colour",
        [helper.make_tensor_value_info("picture", TensorProto.FLOAT, list(shape))],
        [helper.make_tensor_value_info("answer", kind, answer)],
        list(constants),
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    checker.check_model(model)
    save_model(model, str(path))
    return path
