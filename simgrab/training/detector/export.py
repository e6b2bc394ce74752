"""From torch to ONNX: weights kept in half precision, what simgrab must know in the metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from torch import nn

from simgrab.instrument.net import KEY
from simgrab.training.folder import write
from simgrab.training.graph import traced

_LEAST = 256  # numbers in a tensor from which on halves are worth it


def export(net: nn.Module, example: torch.Tensor, outputs: list[str], path: Path, facts: Mapping[str, Any]) -> None:
    """Write a net to ONNX, free in its number of pictures.

    Parameters
    ----------
    net : torch.nn.Module
        In evaluation mode, on the CPU.
    example : Tensor
        What goes in.
    outputs : list of str
        Names of what comes out.
    path : Path
    facts : mapping
        Plain data for the metadata.
    """
    model = halved(traced(net, example, "pictures", outputs))
    model.doc_string = ""
    helper.set_model_props(model, {KEY: json.dumps(facts)})
    onnx.checker.check_model(model)
    write(path, model.SerializeToString())


def halved(model: onnx.ModelProto) -> onnx.ModelProto:
    """Keep a model's large weights in half precision; it multiplies in single as before."""
    result = onnx.ModelProto()
    result.CopyFrom(model)
    casts = []
    for tensor in result.graph.initializer:
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < _LEAST:
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), f"{name}_half"))
        casts.append(helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = list(result.graph.node)
    del result.graph.node[:]
    result.graph.node.extend([*casts, *nodes])
    return result
