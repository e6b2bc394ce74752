"""Nets made by hand, sound and hostile."""

from __future__ import annotations

import json

import numpy as np
import pytest

from simgrab.instrument.detect.grab import COARSE, POSE
from simgrab.instrument.detect.patches import POSE_SIZE
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


def with_metadata(path, out=None, **metadata):
    """Write a net with other metadata, by default in its place."""
    net, out = onnx.load(path), out or path
    helper.set_model_props(net, metadata)
    onnx.save(net, out)
    return out


def constant_yolo(path, out, *, shape=(1, 3, SIDE, SIDE), metadata=None):
    """A net that says the same of every picture."""
    out = np.asarray(out, np.float32)
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["m"], keepdims=0),
        helper.make_node("Mul", ["m", "zero"], ["z"]),
        helper.make_node("Add", ["rows", "z"], ["output"]),
    ]
    weights = [("zero", np.float32(0)), ("rows", out)]
    inputs, outputs = [("images", TensorProto.FLOAT, list(shape))], [("output", list(out.shape))]
    return save(path, nodes, inputs, outputs, weights, metadata=metadata)


def rows(count, columns):
    result = np.zeros((1, count, columns), np.float32)
    result[0, :, :2] = np.linspace(0, SIDE, count)[:, None]
    result[0, :, 2:4] = 8
    return result


def hand_made(folder, *, heat=4.0, presence=3.0, yaw=0.0, glow=0.0, calibration=None):
    """Nets that see a grab in the brightest part of the picture, in the middle of the pose net's crop.

    ``yaw`` is what the pose net outputs, rad, and ``glow`` how much is added to its logit in a crop that is all light.
    """
    folder.mkdir(exist_ok=True)
    rows, light = np.zeros((1, 16), np.float32), np.zeros((6, 16), np.float32)
    rows[0] = [0.2, 0.2, 0.8, 0.8, 0.5, 0.5, *[-4] * 6, np.cos(2 * yaw), np.sin(2 * yaw), -3, presence]
    light[:3, 15] = glow / 3 / 255
    coarse = [
        helper.make_node("Cast", ["pictures"], ["f"], to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["f"], ["t"], perm=[0, 3, 1, 2]),
        helper.make_node("AveragePool", ["t"], ["p"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("ReduceMean", ["p", "one"], ["g"], keepdims=0),
        helper.make_node("Mul", ["g", "gain"], ["s"]),
        helper.make_node("Sub", ["s", "shift"], ["heat"]),
        helper.make_node("Expand", ["twenty", "wide"], ["reach"]),
    ]
    save(
        folder / "coarse.onnx", coarse, [("pictures", TensorProto.UINT8, [1, 224, 384, 3])],
        [("heat", [1, 28, 48]), ("reach", [1, 4, 28, 48])],
        [("one", np.array([1], np.int64)), ("gain", np.float32((heat + 8) / 255)), ("shift", np.float32(8)),
         ("twenty", np.float32(20).reshape(1, 1, 1, 1)), ("wide", np.array([1, 4, 28, 48], np.int64))],
        {"task": COARSE},
    )  # fmt: skip
    pose = [
        helper.make_node("Cast", ["pictures"], ["f"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["f", "axes"], ["m"], keepdims=0),
        helper.make_node("MatMul", ["m", "light"], ["z"]),
        helper.make_node("Add", ["z", "rows"], ["pose"]),
    ]
    save(
        folder / "pose.onnx", pose,
        [("pictures", TensorProto.UINT8, ["n", POSE_SIZE, POSE_SIZE, 6])], [("pose", ["n", 16])],
        [("axes", np.array([1, 2], np.int64)), ("light", light), ("rows", rows)],
        {"task": POSE, "settings": {"least_heat": 0.2}, "calibration": calibration or {}},
    )  # fmt: skip
    return folder
