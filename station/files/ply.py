"""Point clouds as PLY files. Source: G. Turk, The PLY polygon file format, 1994."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.bounded import MAX_FILE_BYTES, MAX_LINE_BYTES, read_file, shown
from shared.errors import DataError
from shared.geometry import MAX_POSITION, FloatArray

# numpy's type → PLY's names for it: the one that is written, and a newer one
TYPE_NAMES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
PLY_TYPES = {name: kind for kind, names in TYPE_NAMES.items() for name in names}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
MAX_HEADER_BYTES = 65_536
MAX_POINTS = 200_000_000
MAX_DIGITS = 20  # of a count: Python reads no integer of thousands
ROWS_AT_ONCE = 4096

Columns = dict[str, npt.NDArray[Any]]


def write_ply(path: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write a cloud, binary little endian. Columns (N,) in order: x, y, z first, further ones under their names."""
    path.write_bytes(encode_ply(columns))


def encode_ply(columns: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """A cloud as the bytes of a PLY file, binary little endian."""
    count = len(next(iter(columns.values())))
    types = [(name, "<" + column.dtype.str[1:]) for name, column in columns.items()]
    table = np.empty(count, dtype=types)
    for name, column in columns.items():
        table[name] = column
    properties = "".join(f"property {TYPE_NAMES[kind[1:]][0]} {name}\n" for name, kind in types)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n"
    return header.encode("ascii") + table.tobytes()


def cloud_columns(p: npt.NDArray[np.floating], rgb: npt.NDArray[np.uint8]) -> Columns:
    """Points (N, 3) and their colours (N, 3) as columns."""
    named = zip(("x", "y", "z", "red", "green", "blue"), (*p.T, *rgb.T), strict=True)
    return dict(named)


def read_ply(path: Path) -> Columns:
    """Read the vertices of a PLY file, ascii or binary: every scalar property under its name, (N,).

    Raises:
        DataError: no PLY file, damaged, or without x, y, z; says which.
    """
    try:
        content = read_file(path, MAX_FILE_BYTES)
    except OSError as exc:
        raise DataError(f"{path} cannot be read ({exc.strerror}); give a PLY file") from exc
    return decode_ply(content, path)


def decode_ply(content: bytes, path: Path) -> Columns:
    """As read_ply, from the bytes of a PLY file; `path` is what messages call it."""
    file_format, elements, body = _parse_header(path, content)
    for name, count, properties in elements:
        if any(kind == "list" for _, kind in properties):
            break  # faces before vertices: nobody writes that
        types = [(key, FORMATS[file_format] + PLY_TYPES[kind]) for key, kind in properties]
        if file_format == "ascii":
            columns, body = _read_ascii(path, body, count, types)
        else:
            columns, body = _read_binary(path, body, count, types)
        if name == "vertex":
            if not {"x", "y", "z"} <= columns.keys():
                raise DataError(f"{path} has vertices without x, y and z; export it as a point cloud")
            for axis in "xyz":
                far = columns[axis][np.isfinite(columns[axis]) & ~(np.abs(columns[axis]) < MAX_POSITION)]
                if len(far):
                    raise DataError(
                        f"{path} has a point at {axis} = {far[0]:g}, farther than {MAX_POSITION:g}; remove it"
                    )
            return columns
    raise DataError(f"{path} holds no vertices; export it as a point cloud")


def read_rows(path: Path) -> FloatArray:
    """x, y, z of every vertex (N, 3) of a PLY file, finite or not. Raises DataError as read_ply does."""
    columns = read_ply(path)
    return np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)


def _parse_header(path: Path, content: bytes) -> tuple[str, list[tuple[str, int, list[tuple[str, str]]]], bytes]:
    end = content.find(b"end_header", 0, MAX_HEADER_BYTES)
    newline = content.find(b"\n", end)
    if not content.startswith(b"ply") or end < 0 or newline < 0:
        raise DataError(f"{path} is not a PLY file (no ply … end_header); give a PLY point cloud")
    file_format = ""
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in content[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        match words:
            case ["format", kind, *_]:
                file_format = kind
            case ["element", name, count] if count.isdecimal() and len(count) < MAX_DIGITS:
                elements.append((name, int(count), []))
            case ["property", "list", _, _, name] if elements:
                elements[-1][2].append((name, "list"))
            case ["property", kind, name] if elements and kind in PLY_TYPES:
                elements[-1][2].append((name, kind))
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise DataError(f"{path} has an unreadable header line {shown(line)}; export the cloud again")
    if file_format not in FORMATS:
        raise DataError(f"{path} has the unknown PLY format {file_format!r}; export it as ascii or binary")
    if any(count > MAX_POINTS for _, count, _ in elements):
        raise DataError(f"{path} claims more than {MAX_POINTS} points; thin it out")
    for name, _, properties in elements:
        keys = [key for key, _ in properties]
        if len(set(keys)) != len(keys):
            raise DataError(f"{path} names a property of {name} twice; export the cloud again")
    return file_format, elements, content[newline + 1 :]


def _read_binary(path: Path, body: bytes, count: int, types: list[tuple[str, str]]) -> tuple[Columns, bytes]:
    dtype = np.dtype(types)
    if not types:
        raise DataError(f"{path} has points without numbers; export it as a point cloud")
    if len(body) < count * dtype.itemsize:
        whole = len(body) // dtype.itemsize
        raise DataError(f"{path} ends after {whole} of {count} points; copy it again")
    table = np.frombuffer(body, dtype=dtype, count=count)
    columns = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name, _ in types}
    return columns, body[count * dtype.itemsize :]


def _read_ascii(path: Path, body: bytes, count: int, types: list[tuple[str, str]]) -> tuple[Columns, bytes]:
    lines, parts = io.BytesIO(body), []
    try:
        for first in range(0, count, ROWS_AT_ONCE):
            rows = [_numbers(lines.readline(MAX_LINE_BYTES)) for _ in range(min(ROWS_AT_ONCE, count - first))]
            # By way of double: integers up to 2**53 are exact.
            parts.append(np.array(rows, dtype=np.float64).reshape(len(rows), len(types)))
    except ValueError as exc:
        raise DataError(
            f"{path} holds a line that is not {len(types)} numbers, or too few lines; copy it again"
        ) from exc
    table = np.concatenate([np.empty((0, len(types))), *parts])
    return {name: table[:, i].astype(kind) for i, (name, kind) in enumerate(types)}, body[lines.tell() :]


def _numbers(line: bytes) -> list[bytes]:
    if not line:
        raise ValueError("the file ends")
    return line.split()
