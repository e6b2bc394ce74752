"""From torch to ONNX, with what simgrab must know in the metadata."""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from torch import nn

from simgrab.training.folder import write

OPSET = 18
_LEAST = 256  # numbers in a tensor from which on halves are worth it


def export(
    net: nn.Module, example: torch.Tensor, taken: str, outputs: list[str], path: Path, facts: Mapping[str, Any], *,
    key: str, halves: bool = False,
) -> None:  # fmt: skip
    """Write a net to ONNX, free in the number of its examples.

    Parameters
    ----------
    net : torch.nn.Module
        In evaluation mode, on the CPU.
    example : Tensor
        What goes in.
    taken : str
        Name of what goes in.
    outputs : list of str
        Names of what comes out.
    facts : mapping
        Plain data for the metadata.
    key : str
        Of the metadata.
    halves : bool
        Whether to keep large weights in half precision; the net multiplies in single as before.
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        draft = Path(folder) / "draft.onnx"
        # TorchScript's exporter is deprecated; it folds norms into convolutions, and writes the plainest graphs.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            net, (example,), str(draft), input_names=[taken], output_names=outputs,
            dynamic_axes={name: {0: "n"} for name in (taken, *outputs)}, opset_version=OPSET, dynamo=False,
        )  # fmt: skip
        model = onnx.load(draft)
    if halves:
        _halve(model.graph)
    model.doc_string = ""
    helper.set_model_props(model, {key: json.dumps(facts)})
    onnx.checker.check_model(model)
    write(path, model.SerializeToString())


def _halve(graph: onnx.GraphProto) -> None:
    casts = []
    for tensor in graph.initializer:
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < _LEAST:
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), f"{name}_half"))
        casts.append(helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = list(graph.node)
    del graph.node[:]
    graph.node.extend([*casts, *nodes])
