"""Hostile ONNX files: small nets whose shapes, types, nodes and metadata are not a detector's."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import onnx
from hypothesis import assume
from hypothesis import strategies as st
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
    {"simgrab": '{"task": "find-grab"}'}, {"simgrab": '{"task": []}'}, {"simgrab": '{"task": "settle-grab"}'},
    {"simgrab": "9" * 6000},
    {"simgrab": '{"task": "a\\nb"}'}, {"x" * 500: "y" * 5000},
)  # fmt: skip
_TYPES = (TensorProto.FLOAT,) * 8 + (
    TensorProto.FLOAT16, TensorProto.DOUBLE, TensorProto.INT64, TensorProto.UINT8, TensorProto.BOOL, TensorProto.STRING,
)  # fmt: skip
_IMAGES: tuple[str, int, Any] = ("images", TensorProto.FLOAT, (1, 3, SIDE, SIDE))
_FILLS = (0.0, 0.5, 1.0, -1.0, 8.0, 1e38, 3e38, float("nan"), float("inf"))


def constant(
    out: np.ndarray, shape: tuple[int | str | None, ...] = (1, 3, SIDE, SIDE), kind: int = TensorProto.FLOAT,
    metadata: dict[str, str] | None = None, name: str = "images",
) -> bytes:  # fmt: skip
    """Make a net that returns the same for every picture."""
    nodes = [
        helper.make_node("Cast", [name], ["f"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["f"], ["m"], keepdims=0),
        helper.make_node("Mul", ["m", "zero"], ["z"]),
        helper.make_node("Add", ["rows", "z"], ["output"]),
    ]
    weights = {"zero": np.float32(0), "rows": out}
    return _model(nodes, [(name, kind, shape)], [("output", out.shape)], weights, metadata)


def _model(
    nodes: list[Any], inputs: list[tuple[str, int, Any]], outputs: list[tuple[str, Any]], weights: dict[str, Any],
    metadata: dict[str, str] | None,
) -> bytes:  # fmt: skip
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info(name, kind, shape) for name, kind, shape in inputs],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in weights.items()],
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


@st.composite
def net(draw: st.DrawFn) -> bytes:
    """ONNX files near a detector's."""
    metadata = draw(st.sampled_from(METADATA)) | draw(st.sampled_from(METADATA))
    special = draw(st.integers(0, 9))
    try:
        if special < len(_SPECIAL):
            return _SPECIAL[special](draw, metadata)
        family = draw(st.sampled_from(("yolov5", "yolox", "yolov8")))
        out = rows(family, draw(st.sampled_from((1, 1, 1, 2, 0, 80))), draw(st.none() | st.sampled_from(_FILLS)))
        if draw(st.integers(0, 3)) == 0:
            out = np.resize(out, draw(st.lists(st.sampled_from((0, 1, 2, 5, 6, CELLS)), max_size=5)))
        name = draw(st.sampled_from(("images", "images", "images", "x\ny", "é", "x" * 3000, "output_0")))
        return constant(out, _shape(draw), draw(st.sampled_from(_TYPES)), metadata, name)
    except (ValueError, TypeError, OverflowError):
        assume(False)
        raise


def _shape(draw: st.DrawFn) -> tuple[int | str | None, ...]:
    """Draw the shape of a net's input: a batch of pictures, or nearly so."""
    shape: list[int | str | None] = [1, 3, SIDE, SIDE]
    if draw(st.booleans()):
        places: tuple[tuple[int | str | None, ...], ...] = ((0, 2, "n"), (1, 4, "c"), _SIDES, _SIDES)
        i = draw(st.integers(0, 3))
        shape[i] = draw(st.sampled_from(places[i]))
    return tuple(shape[: draw(st.sampled_from((4, 4, 4, 4, 4, 4, 3, 2, 0)))])


def _memory(draw: st.DrawFn, metadata: dict[str, str]) -> bytes:
    """Make a net with a large constant."""
    shapes = ((1, 6, 10**9), (10**6, 10**6), (2**40,), (1, 3 * 10**8), (-1, 5), (0,))
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["big"]),
        helper.make_node("ReduceSum", ["big"], ["sum"], keepdims=0),
        helper.make_node("Mul", ["sum", "zero"], ["z"]),
        helper.make_node("ReduceMean", ["images"], ["m"], keepdims=0),
        helper.make_node("Mul", ["m", "z"], ["zz"]),
        helper.make_node("Add", ["rows", "zz"], ["output"]),
    ]
    out = rows("yolox")
    weights = {"shape": np.array(draw(st.sampled_from(shapes)), np.int64), "zero": np.float32(0), "rows": out}
    return _model(nodes, [_IMAGES], [("output", out.shape)], weights, metadata)


def _two_inputs(_draw: st.DrawFn, metadata: dict[str, str]) -> bytes:
    nodes = [helper.make_node("Add", ["a", "b"], ["output"])]
    return _model(nodes, [("a", *_IMAGES[1:]), ("b", *_IMAGES[1:])], [("output", _IMAGES[2])], {}, metadata)


def _operator(draw: st.DrawFn, metadata: dict[str, str]) -> bytes:
    """Make a net of a node that does not exist, or that fails when run."""
    node = draw(st.sampled_from(("Nothing\nat all", "If", "Loop", "Gather", "Reshape", "Identity")))
    inputs = {"Gather": ["images", "index"], "Reshape": ["images", "index"]}.get(node, ["images"])
    weights = {"index": np.array([10**6, -5], np.int64)}
    return _model([helper.make_node(node, inputs, ["output"])], [_IMAGES], [("output", None)], weights, metadata)


def _external(draw: st.DrawFn, metadata: dict[str, str]) -> bytes:
    """Make a net whose weights are to lie in another file."""
    model = onnx.load_from_string(constant(rows("yolox"), metadata=metadata))
    tensor = model.graph.initializer[-1]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, values in {
        "location": ("weights.bin", "../../etc/passwd", "/etc/passwd", "", "/dev/zero", "a\nb"),
        "offset": ("0", "-1", "9" * 30),
        "length": ("0", "4", "2016", "-1", str(2**62)),
    }.items():
        tensor.external_data.add(key=key, value=draw(st.sampled_from(values)))
    return bytes(model.SerializeToString())


_SPECIAL = (_memory, _two_inputs, _operator, _external)
