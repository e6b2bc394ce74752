"""Hostile ONNX files: small nets whose shapes, types and metadata are not a detector's."""

from __future__ import annotations

import json
from random import Random

import numpy as np
from onnx import TensorProto, helper, numpy_helper

SIDE = 64
CELLS = 64 + 16 + 4  # of strides 8, 16 and 32
_SIDES: tuple[int | str | None, ...] = (SIDE, SIDE, SIDE, 32, 640, "side", None, 0, 1, 33, 2**20, 2**31 - 1)
_DEEP = "[" * 3000 + "]" * 3000
METADATA: tuple[dict[str, str], ...] = (
    {}, {}, {"names": "{0: 'grab'}"}, {"names": "{0: 'a', 1: 'grab'}"}, {"names": "['grab', 'grab']"}, {"names": _DEEP},
    {"names": "__import__('os').abort()"}, {"names": "{0: 1}"}, {"names": "{[]: 1}"}, {"names": "9" * 6000},
    {"names": "\0"},
    {"imgsz": "[64, 64]"}, {"imgsz": "[0, 64]"}, {"imgsz": "[True, True]"}, {"imgsz": "[10000000, 10000000]"},
    {"imgsz": "[-32, 64]"},
    {"imgsz": _DEEP}, {"task": "segment"}, {"task": "detect"}, {"simgrab": "{}"}, {"simgrab": _DEEP},
    {"simgrab": "nan"},
    {"simgrab": '{"task": "coarse-grab"}'}, {"simgrab": '{"task": []}'}, {"simgrab": '{"task": "grab-pose"}'},
    {"simgrab": "9" * 6000},
    {"simgrab": '{"task": "a\\nb"}'}, {"x" * 500: "y" * 5000},
)  # fmt: skip
_TYPES = (TensorProto.FLOAT,) * 8 + (
    TensorProto.FLOAT16, TensorProto.DOUBLE, TensorProto.INT64, TensorProto.UINT8, TensorProto.BOOL, TensorProto.STRING,
)  # fmt: skip
_FILLS = (0.0, 0.5, 1.0, -1.0, 8.0, 1e38, 3e38, float("nan"), float("inf"))


def constant(
    out: np.ndarray, shape: tuple[int | str | None, ...] = (1, 3, SIDE, SIDE), kind: int = TensorProto.FLOAT,
    metadata: dict[str, str] | None = None, name: str = "images",
) -> bytes:  # fmt: skip
    """Make a net that returns the same for every picture."""
    graph = helper.make_graph(
        [
            helper.make_node("Cast", [name], ["f"], to=TensorProto.FLOAT),
            helper.make_node("ReduceMean", ["f"], ["m"], keepdims=0),
            helper.make_node("Mul", ["m", "zero"], ["z"]),
            helper.make_node("Add", ["rows", "z"], ["output"]),
        ],
        "g",
        [helper.make_tensor_value_info(name, kind, shape)],
        [helper.make_tensor_value_info("output", TensorProto.FLOAT, out.shape)],
        [numpy_helper.from_array(np.zeros((), np.float32), "zero"), numpy_helper.from_array(out, "rows")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    helper.set_model_props(model, metadata or {})
    return bytes(model.SerializeToString())


def rows(family: str, classes: int = 1, fill: float | None = None) -> np.ndarray:
    """Output of a detector for pictures of 64 px: boxes all over the picture, with scores of 0.5."""
    count, columns = (3 * CELLS if family == "yolov5" else CELLS), 4 + classes + (family != "yolov8")
    out = np.full((1, count, columns), 0.5, np.float32)
    out[0, :, :2] = np.linspace(0, SIDE, count)[:, None]
    out[0, :, 2:4] = 8
    if fill is not None:
        out[0, count // 2 :] = fill
    return np.ascontiguousarray(out.transpose(0, 2, 1)) if family == "yolov8" else out


def seeds() -> list[bytes]:
    """Sound detectors of each layout."""
    names = {"names": json.dumps(["a", "grab"])}
    return [constant(rows(family)) for family in ("yolov5", "yolox", "yolov8")] + [
        constant(rows("yolov8", 2), metadata=names), constant(rows("yolox"), ("n", 3, "h", "w")),
    ]  # fmt: skip


def net(rng: Random) -> bytes:
    """ONNX files near a detector's."""
    metadata = rng.choice(METADATA) | rng.choice(METADATA)
    try:
        family = rng.choice(("yolov5", "yolox", "yolov8"))
        out = rows(family, rng.choice((1, 1, 1, 2, 0, 80)), rng.choice((None, rng.choice(_FILLS))))
        if rng.random() < 0.25:
            out = np.resize(out, rng.choices((0, 1, 2, 5, 6, CELLS), k=rng.randrange(6)))
        name = rng.choice(("images", "images", "images", "x\ny", "é", "x" * 3000, "output_0"))
        return constant(out, _shape(rng), rng.choice(_TYPES), metadata, name)
    except (ValueError, TypeError, OverflowError):  # onnx refuses to write it
        return net(rng)


def _shape(rng: Random) -> tuple[int | str | None, ...]:
    """Draw the shape of a net's input: a batch of pictures, or nearly so."""
    shape: list[int | str | None] = [1, 3, SIDE, SIDE]
    if rng.random() < 0.5:
        places: tuple[tuple[int | str | None, ...], ...] = ((0, 2, "n"), (1, 4, "c"), _SIDES, _SIDES)
        i = rng.randrange(4)
        shape[i] = rng.choice(places[i])
    return tuple(shape[: rng.choice((4, 4, 4, 4, 4, 4, 3, 2, 0))])
