"""The two nets. Pictures go in as bytes, (n, height, width, channels), as they are."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, pad, relu

from simgrab.instrument.detect.patches import POSE_CHANNELS, POSE_SIZE
from simgrab.training.detector.trunk import CHANNELS, ENTRANCE, Trunk

STRIDE = 8  # of the coarse net's maps
REACH = 32.0  # px of the small picture, the coarse net's unit of distance
CELL = 4  # px of a crop, the step of the pose net's positions
BEYOND = 8  # cells beyond either side of a crop in which a position may lie
EDGES, CENTRE, YAW, PRESENCE = slice(0, 4), slice(4, 6), slice(12, 14), 15  # columns of the pose net's output
EDGE_SCALES, CENTRE_SCALES, YAW_SCALE = slice(6, 10), slice(10, 12), 14
COLUMNS = 16
_SHIFT = 0.1  # of a crop, the unit of what the summary adds to a guess at the grab centre
_WIDTH = 64  # channels of the features that the heads get
_SUMMARY = 192


def _conv(ins: int, outs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(ins, outs, 3, padding=1, bias=False), nn.BatchNorm2d(outs), nn.ReLU(inplace=True))


class _Pyramid(nn.Module):
    """From the coarsest features up to finer ones (Lin et al. 2017)."""

    def __init__(self, finest: int) -> None:
        super().__init__()
        self.strides = [stride for stride in sorted(CHANNELS, reverse=True) if stride >= finest]
        self.across = nn.ModuleList(nn.Conv2d(CHANNELS[stride], _WIDTH, 1) for stride in self.strides)
        self.merge = nn.ModuleList(_conv(_WIDTH, _WIDTH) for _ in self.strides[1:])

    def forward(self, levels: dict[int, Tensor]) -> Tensor:
        x: Tensor = self.across[0](levels[self.strides[0]])
        for k, stride in enumerate(self.strides[1:]):
            x = interpolate(x, scale_factor=2.0, mode="nearest")
            x = self.merge[k](x + self.across[k + 1](levels[stride]))
        return x


def _normalised(pictures: Tensor) -> Tensor:
    return pictures.permute(0, 3, 1, 2).float().sub_(127.5).div_(127.5)


class Coarse(nn.Module):
    """Where the visible box's centre is in the whole picture, and how far its edges are from there.

    In: uint8 (n, height, width, 3), height and width multiples of 32. Out: ``heat`` (n, height/8, width/8), logits, and
    ``reach`` (n, 4, height/8, width/8): from a cell's middle to the left, top, right and bottom edge, px.
    """

    def __init__(self) -> None:
        super().__init__()
        self.trunk, self.pyramid = Trunk(), _Pyramid(STRIDE)
        last = nn.Conv2d(_WIDTH, 5, 1)
        self.head = nn.Sequential(_conv(_WIDTH, _WIDTH), last)
        assert last.bias is not None
        nn.init.normal_(last.weight, std=0.01)
        nn.init.zeros_(last.bias)
        with torch.no_grad():
            last.bias[0] = -4.0  # few cells are a centre (Lin et al. 2017)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        out = self.head(self.pyramid(self.trunk(_normalised(pictures)))).float()
        return out[:, 0], torch.exp(out[:, 1:].clamp(-5.0, 3.0)) * REACH


class Pose(nn.Module):
    """Whether a crop around a candidate shows the grab, and where exactly.

    In: uint8 (n, size, size, channels) of `simgrab.instrument.detect.patches.cut_crop`. Out: (n, 16), by the slices
    above. Edges x0, y0, x1, y1 and grab centre u, v in shares of the crop, and the logarithm of the Laplace scale of
    each; cos 2φ and sin 2φ of the yaw φ, and the logarithm of the scale of 2φ, rad; the logit of the presence.
    """

    def __init__(self) -> None:
        super().__init__()
        self.trunk, self.pyramid = Trunk(), _Pyramid(CELL)
        self.place = nn.Conv2d(POSE_CHANNELS - 3, CHANNELS[ENTRANCE], ENTRANCE, ENTRANCE)
        nn.init.zeros_(self.place.weight)  # the trunk begins as it was learned
        assert self.place.bias is not None
        nn.init.zeros_(self.place.bias)
        # The position of the coarsest features shows from which side the grab is seen, and so where its centre is.
        cells = (POSE_SIZE // 32) ** 2
        self.where = nn.Sequential(nn.Conv2d(CHANNELS[32], 32, 1), nn.ReLU(inplace=True), nn.Flatten())
        self.summary = nn.Sequential(nn.Linear(32 * cells + CHANNELS[32], _SUMMARY), nn.ReLU(inplace=True))
        self.along_x, self.along_y = _Positions(), _Positions()
        self.rest = nn.Linear(_SUMMARY, 14)
        self.presence = nn.Sequential(nn.Dropout(0.2), nn.Linear(_SUMMARY, 1))
        nn.init.normal_(self.rest.weight, std=0.01)

    def forward(self, crops: Tensor) -> Tensor:
        """See the class."""
        return self.outputs_and_weights(crops)[0]

    def outputs_and_weights(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Return what goes out, and of which cells, by logarithmic weights (n, 6, cells), each position is the mean."""
        pictures = _normalised(crops)
        levels = self.trunk(pictures[:, :3], self.place(pictures[:, 3:]))
        fine, coarse = self.pyramid(levels), levels[32]
        summary = self.summary(torch.cat([self.where(coarse), coarse.mean((2, 3))], 1))
        x, across = self.along_x(torch.cat([fine.mean(2), fine.amax(2)], 1), summary)
        y, down = self.along_y(torch.cat([fine.mean(3), fine.amax(3)], 1), summary)
        rest = self.rest(summary).float()
        scales = rest[:, :6].clamp(-6.0, 4.0) - 4.0
        places = _alternate(x, y)
        # Two guesses at the grab centre, its position and the middle of the box, which the summary shifts and weighs.
        guesses = torch.stack([places[:, CENTRE], (places[:, :2] + places[:, 2:4]) / 2], 1)
        guesses = guesses + _SHIFT * rest[:, 9:13].unflatten(1, (2, 2))
        share = torch.sigmoid(rest[:, 13:])
        places = torch.cat([places[:, EDGES], share * guesses[:, 0] + (1 - share) * guesses[:, 1]], 1)
        logit = self.presence(summary).float()
        out = [places, scales, rest[:, 6:8], rest[:, 8:9].clamp(-6.0, 4.0) - 2.0, logit]
        return torch.cat(out, 1), _alternate(across, down)


def pretrained(kind: type[Coarse | Pose]) -> Coarse | Pose:
    """Build a net with a trunk that was trained on ImageNet."""
    net = kind()
    net.trunk.load()
    return net


def _alternate(x: Tensor, y: Tensor) -> Tensor:
    """Turn three of x and three of y into x, y, x, y, x, y."""
    return torch.stack([x, y], 2).flatten(1, 2)


class _Positions(nn.Module):
    """Three positions along one axis, by the mean of a softmax over cells (soft-argmax)."""

    def __init__(self) -> None:
        super().__init__()
        self.enter = nn.Conv1d(2 * _WIDTH, _WIDTH, 1)
        self.context = nn.Linear(_SUMMARY, _WIDTH)
        self.layers = nn.Sequential(
            nn.Conv1d(_WIDTH, _WIDTH, 9, padding=4), nn.ReLU(inplace=True),
            nn.Conv1d(_WIDTH, _WIDTH, 9, padding=4), nn.ReLU(inplace=True),
            nn.Conv1d(_WIDTH, 3, 9, padding=4),
        )  # fmt: skip

    def forward(self, profile: Tensor, summary: Tensor) -> tuple[Tensor, Tensor]:
        """Shares of the crop, (n, 3), of a profile (n, channels, cells), and the cells' logarithmic weights."""
        cells = profile.shape[-1]
        x = pad(self.enter(profile), (BEYOND, BEYOND)) + self.context(summary)[:, :, None]
        weight = self.layers(relu(x)).float().log_softmax(-1)
        middles = (torch.arange(-BEYOND, cells + BEYOND, device=x.device) + 0.5) / cells
        return (weight.exp() * middles).sum(-1), weight
