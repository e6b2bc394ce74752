"""The nets; settle is built as refine is. Pictures go in as bytes, (n, height, width, channels), as they are."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, pad, relu

from simgrab.instrument.detect.patches import REFINE_SIZE, VERIFY_SIZE

STRIDE = 8  # of find's maps
REACH = 32.0  # px of the small picture, find's unit of distance
CELL = 4  # px of a crop, the step of refine's positions
BEYOND = 8  # cells beyond either side of a crop in which a position may lie
EDGES, CENTRE, YAW, PRESENCE = slice(0, 4), slice(4, 6), slice(12, 14), 15  # columns of refine's output
EDGE_SCALES, CENTRE_SCALES, YAW_SCALE = slice(6, 10), slice(10, 12), 14
COLUMNS = 16
_SHIFT = 0.1  # of a crop, the unit of what the summary adds to the grab centre


def _conv(ins: int, outs: int, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(ins, outs, kernel, stride, kernel // 2, bias=False), nn.BatchNorm2d(outs), nn.ReLU(inplace=True)
    )


class _Residual(nn.Module):
    """Two convolutions beside an identity (He et al. 2016)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = _conv(width, width)
        norm = nn.BatchNorm2d(width)
        nn.init.zeros_(norm.weight)  # begins as the identity
        self.second = nn.Sequential(nn.Conv2d(width, width, 3, 1, 1, bias=False), norm)

    def forward(self, x: Tensor) -> Tensor:
        return relu(x + self.second(self.first(x)))


class _Trunk(nn.Module):
    """Residual stages, each half as fine as the one before, and the way back up to the finest that is wanted."""

    def __init__(self, channels: int, widths: tuple[int, ...], depths: tuple[int, ...], up: int, stride: int) -> None:
        super().__init__()
        ins = (channels, *widths[:-1])
        first = _conv(channels, widths[0], stride, kernel=2 * stride - 1)
        enter = [first, *(_conv(i, o, 2) for i, o in zip(ins[1:], widths[1:], strict=True))]
        self.stages = nn.ModuleList(
            nn.Sequential(step, *(_Residual(width) for _ in range(depth)))
            for step, width, depth in zip(enter, widths, depths, strict=True)
        )
        self.down_to = len(widths) - 1 - up
        self.across = nn.ModuleList(
            nn.Conv2d(widths[k + 1], widths[k], 1) for k in range(self.down_to, len(widths) - 1)
        )
        self.merge = nn.ModuleList(_conv(widths[k], widths[k]) for k in range(self.down_to, len(widths) - 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the finest features that are wanted, and the coarsest."""
        levels = []
        for stage in self.stages:
            x = stage(x)
            levels.append(x)
        coarse = x
        for k in reversed(range(len(self.across))):
            x = interpolate(self.across[k](x), scale_factor=2.0, mode="nearest")
            x = self.merge[k](x + levels[self.down_to + k])
        return x, coarse


def _normalised(pictures: Tensor) -> Tensor:
    return pictures.permute(0, 3, 1, 2).float().sub_(127.5).div_(127.5)


class Find(nn.Module):
    """Where the visible box's centre is, and how far its edges are from there.

    In: uint8 (n, height, width, 3), height and width multiples of 32. Out: ``heat`` (n, height/8, width/8), logits, and
    ``reach`` (n, 4, height/8, width/8): from a cell's middle to the left, top, right and bottom edge, px.
    """

    def __init__(self) -> None:
        super().__init__()
        # One long first step: most of the time would go into finer maps.
        self.trunk = _Trunk(3, (32, 64, 80, 112), (0, 1, 2, 2), up=2, stride=4)
        last = nn.Conv2d(64, 5, 1)
        self.head = nn.Sequential(_conv(64, 64), last)
        assert last.bias is not None
        nn.init.normal_(last.weight, std=0.01)
        nn.init.zeros_(last.bias)
        with torch.no_grad():
            last.bias[0] = -4.0  # few cells are a centre (Lin et al. 2017)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        out = self.head(self.trunk(_normalised(pictures))[0]).float()
        return out[:, 0], torch.exp(out[:, 1:].clamp(-5.0, 3.0)) * REACH


class Refine(nn.Module):
    """Where exactly, in a crop around the found box.

    In: uint8 (n, size, size, 4), the fourth channel saying what lies in the picture. Out: (n, 16), by the slices above.
    Edges x0, y0, x1, y1 and grab centre u, v in shares of the crop, and the logarithm of the Laplace scale of each;
    cos 2φ and sin 2φ of the yaw φ, and the logarithm of the scale of 2φ, rad; the logit of the grab being there.
    """

    def __init__(self) -> None:
        super().__init__()
        self.trunk = _Trunk(4, (24, 48, 72, 96), (0, 1, 2, 2), up=2, stride=2)
        # The position of the coarsest features shows from which side the grab is seen, and so where its centre is.
        cells = (REFINE_SIZE // 16) ** 2
        self.summary = nn.Sequential(
            nn.Conv2d(96, 24, 1), nn.ReLU(inplace=True), nn.Flatten(), nn.Linear(24 * cells, 128), nn.ReLU(inplace=True)
        )
        self.along_x, self.along_y = _Positions(48, 128), _Positions(48, 128)
        self.rest = nn.Linear(128, 12)
        nn.init.normal_(self.rest.weight, std=0.01)

    def forward(self, crops: Tensor) -> Tensor:
        """See the class."""
        return self.outputs_and_weights(crops)[0]

    def outputs_and_weights(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Return what goes out, and of which cells, by logarithmic weights (n, 6, cells), each position is the mean."""
        fine, coarse = self.trunk(_normalised(crops))
        summary = self.summary(coarse)
        x, across = self.along_x(torch.cat([fine.mean(2), fine.amax(2)], 1), summary)
        y, down = self.along_y(torch.cat([fine.mean(3), fine.amax(3)], 1), summary)
        rest = self.rest(summary).float()
        scales = rest[:, :6].clamp(-6.0, 4.0) - 4.0
        places = _alternate(x, y) + pad(_SHIFT * rest[:, 10:], (4, 0))
        out = [places, scales, rest[:, 6:8], rest[:, 8:9].clamp(-6.0, 4.0) - 2.0, rest[:, 9:10]]
        return torch.cat(out, 1), _alternate(across, down)


class Verify(nn.Module):
    """Whether the grab is there, in a crop that shows its surroundings; its first stages are those of refine.

    In: uint8 (n, size, size, 4), the fourth channel saying what lies in the picture. Out: (n, 3), the presence's logit
    and, to learn from alone, the direction in which the ropes leave the grab.

    Parameters
    ----------
    refine : Refine
        Whose stages are copied.
    """

    def __init__(self, refine: Refine) -> None:
        super().__init__()
        self.stages = copy.deepcopy(refine.trunk.stages)
        self.last = nn.Sequential(_conv(96, 128, 2), _Residual(128))
        cells = (VERIFY_SIZE // 32) ** 2
        self.where = nn.Sequential(nn.Conv2d(128, 24, 1), nn.ReLU(inplace=True), nn.Flatten())
        self.head = nn.Sequential(
            nn.Linear(24 * cells + 2 * 128, 96), nn.ReLU(inplace=True), nn.Dropout(0.2), nn.Linear(96, 3)
        )

    def forward(self, crops: Tensor) -> Tensor:
        """See the class."""
        x = _normalised(crops)
        for stage in self.stages:
            x = stage(x)
        x = self.last(x)
        features = torch.cat([self.where(x), x.mean((2, 3)), x.amax((2, 3))], 1)
        return self.head(features).float()


def _alternate(x: Tensor, y: Tensor) -> Tensor:
    """Turn three of x and three of y into x, y, x, y, x, y."""
    return torch.stack([x, y], 2).flatten(1, 2)


class _Positions(nn.Module):
    """Three positions along one axis, by the mean of a softmax over cells (soft-argmax)."""

    def __init__(self, width: int, summary: int) -> None:
        super().__init__()
        self.enter = nn.Conv1d(2 * width, 64, 1)
        self.context = nn.Linear(summary, 64)
        self.layers = nn.Sequential(
            nn.Conv1d(64, 64, 9, padding=4), nn.ReLU(inplace=True),
            nn.Conv1d(64, 64, 9, padding=4), nn.ReLU(inplace=True),
            nn.Conv1d(64, 3, 9, padding=4),
        )  # fmt: skip

    def forward(self, profile: Tensor, summary: Tensor) -> tuple[Tensor, Tensor]:
        """Shares of the crop, (n, 3), of a profile (n, channels, cells), and the cells' logarithmic weights."""
        cells = profile.shape[-1]
        x = pad(self.enter(profile), (BEYOND, BEYOND)) + self.context(summary)[:, :, None]
        weight = self.layers(relu(x)).float().log_softmax(-1)
        middles = (torch.arange(-BEYOND, cells + BEYOND, device=x.device) + 0.5) / cells
        return (weight.exp() * middles).sum(-1), weight
