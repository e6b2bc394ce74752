"""From torch to an ONNX graph."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import onnx
import torch
from torch import nn

OPSET = 18


def traced(net: nn.Module, example: torch.Tensor, taken: str, outputs: list[str]) -> onnx.ModelProto:
    """Trace a net, which becomes free in the number of its examples.

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
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        draft = Path(folder) / "draft.onnx"
        # TorchScript's exporter is deprecated; it folds norms into convolutions, and writes the plainest graphs.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            net, (example,), str(draft), input_names=[taken], output_names=outputs,
            dynamic_axes={name: {0: "n"} for name in (taken, *outputs)}, opset_version=OPSET, dynamo=False,
        )  # fmt: skip
        return onnx.load(draft)
