"""Begin a training with the weights of an exported net, not with random ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from simgrab.errors import TrainingError
from simgrab.instrument.net import open_net
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.training.copies import Batch
from simgrab.training.folder import write
from simgrab.training.loop import Task

_Layer: TypeAlias = nn.Conv1d | nn.Conv2d | nn.Linear
_NODES = ("Conv", "Gemm")
_MEASURED = 128  # examples for the statistics of what goes into the norms
_TOLERANCE = 2e-3  # of what goes out, relative to its largest number; weights lie in half precision


def begun(build: Callable[[], nn.Module], path: Path, examples: Tensor) -> nn.Module:
    """Build a net with the weights of a file that `simgrab.training.export` wrote.

    In the file, norms are folded into convolutions. They are unfolded by the mean and variance that their inputs have
    on the examples: the net then gives what the file gives, and learns as if it had been trained on these examples.

    Parameters
    ----------
    build : callable
        Makes a net of the file's architecture.
    examples : Tensor
        What goes in, several dozen.

    Raises
    ------
    TrainingError
        If the file is of another architecture, or gives something else than the net does.
    """
    known = open_net(path, TrainingError)  # refuses what names other files
    net = build().eval()
    with torch.no_grad():
        layers, weights = _layers(net, examples[:1]), _weights(path)
        shapes = [tuple(layer.weight.shape) for layer, _ in layers]
        if shapes != [weight.shape for weight, _ in weights]:
            raise TrainingError(f"{path} holds another network than is trained: it cannot be started from")
        for (layer, norm), (weight, bias) in zip(layers, weights, strict=True):
            layer.weight.copy_(torch.from_numpy(weight))
            if norm is None:
                assert layer.bias is not None
                layer.bias.copy_(torch.from_numpy(bias))
            else:
                norm.reset_running_stats()  # a net that has been trained has others, which the file knows nothing of
                norm.weight.fill_(float(np.sqrt(1.0 + norm.eps)))
                norm.bias.copy_(torch.from_numpy(bias))
        _unfold([(layer, norm) for layer, norm in layers if norm is not None], net, examples)
        got = net(examples)
    for ours, theirs in zip(got if isinstance(got, tuple) else (got,), known(examples.numpy()), strict=True):
        apart = float(np.abs(ours.numpy() - theirs).max() / max(np.abs(theirs).max(), 1.0))
        if not apart <= _TOLERANCE:
            raise TrainingError(f"{path} cannot be started from: its outputs are off by a share of {apart:.2g}")
    return net


def mix(path: Path, first: Path, share: float) -> None:
    """Leave a share of the weights of a file, and fill it up with those of the one that its training began with.

    The mean of both loses less of what was learned before (Wortsman et al. 2022).

    Raises `TrainingError` if the files are not of one architecture.
    """
    model = onnx.load_from_string(path.read_bytes())
    before = {
        tensor.name: numpy_helper.to_array(tensor)
        for tensor in onnx.load_from_string(first.read_bytes()).graph.initializer
    }
    for tensor in model.graph.initializer:
        now, then = numpy_helper.to_array(tensor), before.get(tensor.name)
        if then is None or then.shape != now.shape:
            raise TrainingError(f"{first} holds another network than {path}: their weights have no mean")
        if np.issubdtype(now.dtype, np.floating):
            mean = share * now.astype(float) + (1 - share) * then.astype(float)
            tensor.CopyFrom(numpy_helper.from_array(mean.astype(now.dtype), tensor.name))
    write(path, model.SerializeToString())


def some_examples(task: Task) -> Batch:
    """Draw examples of a task for `begun`."""
    rng = stream(0, 0, "statistics")
    return task.batch(rng.permutation(task.examples)[:_MEASURED], rng)


def _weights(path: Path) -> list[tuple[Array, Array]]:
    """Weights and biases of a file's layers, in the order in which they run, in single precision."""
    graph = onnx.load_from_string(path.read_bytes()).graph
    known = {tensor.name.removesuffix("_half"): numpy_helper.to_array(tensor) for tensor in graph.initializer}
    inputs = [node.input[1:3] for node in graph.node if node.op_type in _NODES]
    pairs = [[known[name].astype(np.float32) for name in names if name in known] for names in inputs]
    return [(pair[0], pair[1]) for pair in pairs if len(pair) == 2]


def _layers(net: nn.Module, example: Tensor) -> list[tuple[_Layer, nn.BatchNorm2d | None]]:
    """Layers in the order in which they run, each with the norm that follows."""
    ran: list[nn.Module] = []
    hooks = [
        module.register_forward_hook(lambda module, _in, _out: ran.append(module))
        for module in net.modules()
        if isinstance(module, _Layer | nn.BatchNorm2d)
    ]
    net(example)
    for hook in hooks:
        hook.remove()
    after = [*ran[1:], None]
    return [
        (layer, norm if isinstance(norm, nn.BatchNorm2d) else None)
        for layer, norm in zip(ran, after, strict=True)
        if isinstance(layer, _Layer)
    ]


def _unfold(pairs: list[tuple[_Layer, nn.BatchNorm2d]], net: nn.Module, examples: Tensor) -> None:
    """Give norms, which only add a bias, the statistics of what goes into them, and let them undo these."""
    measured: dict[nn.Module, tuple[Tensor, Tensor]] = {}

    def measure(layer: nn.Module, _in: object, out: Tensor) -> None:
        measured[layer] = out.mean((0, 2, 3)), out.var((0, 2, 3))

    hooks = [layer.register_forward_hook(measure) for layer, _ in pairs]
    net(examples)
    for hook in hooks:
        hook.remove()
    for layer, norm in pairs:
        mean, var = measured[layer]
        assert norm.running_mean is not None
        assert norm.running_var is not None
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(var)
        norm.weight.copy_(torch.sqrt(var + norm.eps))
        norm.bias.add_(mean)
