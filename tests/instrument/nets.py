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


def info(name, shape, kind=TensorProto.FLOAT):
    return helper.make_tensor_value_info(name, kind, shape)


def number(name, value, kind=np.float32):
    return numpy_helper.from_array(np.asarray(value, kind), name)


def save(path, nodes, inputs, outputs, weights=(), *, metadata=None, domain=""):
    opsets = [helper.make_opsetid("", 18)] + [helper.make_opsetid(domain, 1)] * bool(domain)
    graph = helper.make_graph(nodes, "g", inputs, outputs, weights)
    model = helper.make_model(graph, opset_imports=opsets, ir_version=10)
    helper.set_model_props(model, metadata or {})
    path.write_bytes(model.SerializeToString())
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
    weights = [number("zero", 0), number("rows", out)]
    return save(path, nodes, [info("images", shape)], [info("output", out.shape)], weights, metadata=metadata)


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
        folder / "coarse.onnx", coarse, [info("pictures", [1, 224, 384, 3], TensorProto.UINT8)],
        [info("heat", [1, 28, 48]), info("reach", [1, 4, 28, 48])],
        [number("one", [1], np.int64), number("gain", (heat + 8) / 255), number("shift", 8),
         number("twenty", [[[[20]]]]), number("wide", [1, 4, 28, 48], np.int64)],
        metadata={KEY: json.dumps({"task": COARSE})},
    )  # fmt: skip
    pose = [
        helper.make_node("Cast", ["pictures"], ["f"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["f", "axes"], ["m"], keepdims=0),
        helper.make_node("MatMul", ["m", "light"], ["z"]),
        helper.make_node("Add", ["z", "rows"], ["pose"]),
    ]
    facts = {"task": POSE, "settings": {"least_heat": 0.2}, "calibration": calibration or {}}
    save(
        folder / "pose.onnx", pose,
        [info("pictures", ["n", POSE_SIZE, POSE_SIZE, 6], TensorProto.UINT8)], [info("pose", ["n", 16])],
        [number("axes", [1, 2], np.int64), number("light", light), number("rows", rows)],
        metadata={KEY: json.dumps(facts)},
    )  # fmt: skip
    return folder
