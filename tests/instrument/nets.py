"""Nets made by hand, sound and hostile."""

from __future__ import annotations

import json

import numpy as np
import pytest

from simgrab.instrument.detect.bundled import FIND, REFINE, SETTLE
from simgrab.instrument.net import KEY

onnx = pytest.importorskip("onnx")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

SIDE = 64  # px of the hand-made YOLOs' pictures
CELLS = 64 + 16 + 4


def save(path, nodes, inputs, outputs, weights=(), facts=None, metadata=None):
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info(name, kind, shape) for name, kind, shape in inputs],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs],
        [numpy_helper.from_array(value, name) for name, value in weights],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    helper.set_model_props(model, (metadata or {}) | ({KEY: json.dumps(facts)} if facts else {}))
    onnx.save(model, path)
    return path


def constant_yolo(path, out, *, shape=(1, 3, SIDE, SIDE), kind=TensorProto.FLOAT, metadata=None):
    """A net that says the same of every picture."""
    out = np.asarray(out, np.float32)
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["m"], keepdims=0),
        helper.make_node("Mul", ["m", "zero"], ["z"]),
        helper.make_node("Add", ["rows", "z"], ["output"]),
    ]
    weights = [("zero", np.float32(0)), ("rows", out)]
    inputs, outputs = [("images", kind, list(shape))], [("output", list(out.shape))]
    return save(path, nodes, inputs, outputs, weights, metadata=metadata)


def rows(count, columns):
    result = np.zeros((1, count, columns), np.float32)
    result[0, :, :2] = np.linspace(0, SIDE, count)[:, None]
    result[0, :, 2:4] = 8
    return result


def hand_made(folder, *, heat=4.0, presence=3.0, task=REFINE, yaw=0.0, aside=0.0, glow=(0.0, 0.0), outward=0.0):
    """Nets that see a grab in the brightest part of find's picture, and refine it to the middle of the crop.

    ``yaw`` is what refine says, rad, ``aside`` by which share of the level crop settle moves the centre along x,
    ``glow`` by how much more refine and settle believe in a crop that is all light, and ``outward`` what validation
    showed.
    """
    folder.mkdir(exist_ok=True)
    told = np.zeros((1, 16), np.float32)
    told[0, :6], told[0, 6:12], told[0, 12:15], told[0, 15] = (
        [0.2, 0.2, 0.8, 0.8, 0.5, 0.5],
        -4,
        [np.cos(2 * yaw), np.sin(2 * yaw), -3],
        presence,
    )
    settle_more = np.zeros((1, 16), np.float32)
    settle_more[0, 4], settle_more[0, 12:14] = aside, np.array([1, 0]) - told[0, 12:14]
    find = [
        helper.make_node("Cast", ["pictures"], ["f"], to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["f"], ["t"], perm=[0, 3, 1, 2]),
        helper.make_node("AveragePool", ["t"], ["p"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("ReduceMean", ["p", "one"], ["g"], keepdims=0),
        helper.make_node("Mul", ["g", "gain"], ["s"]),
        helper.make_node("Sub", ["s", "shift"], ["heat"]),
        helper.make_node("Expand", ["twenty", "wide"], ["reach"]),
    ]
    save(
        folder / "find.onnx", find, [("pictures", TensorProto.UINT8, [1, 288, 512, 3])],
        [("heat", [1, 36, 64]), ("reach", [1, 4, 36, 64])],
        [("one", np.array([1], np.int64)), ("gain", np.float32((heat + 8) / 255)), ("shift", np.float32(8)),
         ("twenty", np.float32(20).reshape(1, 1, 1, 1)), ("wide", np.array([1, 4, 36, 64], np.int64))],
        {"task": FIND},
    )  # fmt: skip
    refine = [
        helper.make_node("Cast", ["pictures"], ["f"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["f", "axes"], ["m"], keepdims=0),
        helper.make_node("Unsqueeze", ["m", "last"], ["u"]),
        helper.make_node("Mul", ["u", "light"], ["z"]),
        helper.make_node("Add", ["z", "rows"], ["told"]),
    ]
    facts = {"task": SETTLE, "settings": {"least_heat": 0.2}, "trust": {"centre": 2.0, "outward": outward}}
    light = np.zeros((1, 16), np.float32)
    both = (("refine", told, {"task": task}), ("settle", told + settle_more, facts))
    for (name, rows, said), light[0, 15] in zip(both, np.array(glow) / 255, strict=True):
        save(
            folder / f"{name}.onnx", refine, [("pictures", TensorProto.UINT8, ["n", 160, 160, 4])],
            [("told", ["n", 16])],
            [("axes", np.array([1, 2, 3], np.int64)), ("last", np.array([1], np.int64)), ("light", light),
             ("rows", rows)],
            said,
        )  # fmt: skip
    return folder
