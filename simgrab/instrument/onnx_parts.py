"""Look through an ONNX file before onnxruntime opens it.

A tensor of an ONNX file may lie in another file, named by a path. Versions of onnxruntime refuse different sets of
these paths; for a model loaded from bytes they are relative to the working directory. So a file that contains such a
path anywhere is refused here. The numbers of fields are those of onnx/onnx.proto3 of ONNX.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

MOST_PARTS = 1_000_000  # fields of a file that are examined; a YOLO has 10,000 to 100,000

_VARINT, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5  # wire types
_TENSOR = "tensor"
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14  # fields of a tensor
# Message: its fields that are messages in which a tensor may lie.
_INSIDE = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: _TENSOR, 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: _TENSOR, 6: "graph", 10: _TENSOR, 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: _TENSOR, 2: _TENSOR},
    _TENSOR: {},
}


def check(content: bytes, refuse: Callable[[str], Exception]) -> None:
    """Refuse a file that is not ONNX, or that names other files.

    Parameters
    ----------
    content : bytes
        Content of the file.
    refuse : callable
        Makes the error to raise from a message.
    """
    view = memoryview(content)
    waiting = [("model", 0, len(content))]
    parts = 0
    while waiting:
        kind, begin, end = waiting.pop()
        inside, tensor = _INSIDE[kind], kind == _TENSOR
        try:
            for number, first, last in _fields(view, begin, end):
                parts += 1
                if parts > MOST_PARTS:
                    raise refuse(f"has more than {MOST_PARTS} parts")
                if tensor and (number == _EXTERNAL_DATA or (number == _DATA_LOCATION and any(view[first:last]))):
                    raise refuse("keeps weights in another file, which is not opened: save it as one file")
                if number in inside:
                    waiting.append((inside[number], first, last))
        except _NoMessageError:
            raise refuse("is not an ONNX model that can be run (damaged, or another kind of file)") from None


class _NoMessageError(Exception):
    """The bytes are not a Protocol Buffers message."""


def _fields(view: memoryview, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield the number of each field of a message, and the start and end of its value."""
    while at < end:
        key, at = _varint(view, at, end)
        wire = key & 7
        if wire == _BYTES:
            length, at = _varint(view, at, end)
            after = at + length
        elif wire == _VARINT:
            after = _varint(view, at, end)[1]
        elif wire in (_EIGHT_BYTES, _FOUR_BYTES):
            after = at + (8 if wire == _EIGHT_BYTES else 4)
        else:
            raise _NoMessageError
        if after > end or key < 8:
            raise _NoMessageError
        yield key >> 3, at, after
        at = after


def _varint(view: memoryview, at: int, end: int) -> tuple[int, int]:
    """Read a whole number of 7 bits a byte; returns it and the position after it."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= end:
            break
        byte, at = view[at], at + 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise _NoMessageError
