"""What the coarse net learns: heat at the visible box's centre (Zhou et al. 2019), and the distances to its edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from simgrab.instrument.detect.boxes import iou
from simgrab.instrument.detect.patches import COARSE_HEIGHT, COARSE_WIDTH, Patch, Picture, cut, whole
from simgrab.model.geometry import Array
from simgrab.training.copies import Batch
from simgrab.training.detector import cache
from simgrab.training.detector.augment import Dirt, turn
from simgrab.training.detector.nets import STRIDE
from simgrab.training.loop import SCORE

_SIZE = np.array([COARSE_WIDTH, COARSE_HEIGHT], float)
_BATCH = 16  # validation pictures at a time
_LEFT = 0.4  # share of a box that a shift must leave in the picture
_NEAR = 0.3  # target heat above which a cell predicts the edges


@dataclass(frozen=True, eq=False)
class SmallPictures:
    """Small pictures (n, 224, 384, 3), and their boxes (n, 4) in their own pixels, NaN where there is no grab."""

    pictures: NDArray[np.uint8]
    boxes: Array


def pictures(
    folder: Path, chosen: Sequence[cache.TrainingFrame], progress: cache.Progress | None = None
) -> SmallPictures:
    """Shrink the pictures of frames, or find them shrunk in ``folder``."""

    def make(_: int, picture: Picture) -> tuple[Picture, Sequence[Patch]]:
        patch = whole(picture.shape[1], picture.shape[0])
        return cut(picture, patch, COARSE_WIDTH, COARSE_HEIGHT), [patch]

    small, patches = cache.build(folder, chosen, (COARSE_HEIGHT, COARSE_WIDTH, 3), make, progress)
    boxes = np.full((len(chosen), 4), np.nan)
    for i, frame in enumerate(chosen):
        if (corners := frame.box) is not None:
            boxes[i] = (patches[i][0].to_shares(corners.reshape(2, 2)) * _SIZE).ravel()
    return SmallPictures(small, boxes)


class CoarseTask:
    """The coarse net's task (`simgrab.training.loop.Task`)."""

    def __init__(self, train: SmallPictures, validation: SmallPictures) -> None:
        self.train, self.validation, self._dirt = train, validation, Dirt()

    @property
    def examples(self) -> int:
        """Number of training pictures."""
        return len(self.train.pictures)

    def batch(self, chosen: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Augment pictures and set their targets."""
        made = [self._one(int(i), rng) for i in chosen]
        heat, reach = (np.stack(x) for x in zip(*(target(box) for _, box in made), strict=True))
        return {
            "pictures": torch.from_numpy(np.stack([picture for picture, _ in made])),
            "heat": torch.from_numpy(heat),
            "reach": torch.from_numpy(reach),
        }

    def _one(self, i: int, rng: np.random.Generator) -> tuple[Picture, Array]:
        laid = turn(rng, quarters=False)
        picture, sizes = laid.picture(np.asarray(self.train.pictures[i])), np.tile(_SIZE, 2)
        box = laid.box(self.train.boxes[i] / sizes) * sizes
        picture, box = _shifted(np.ascontiguousarray(picture), box, rng)
        return self._dirt(picture, rng), box

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Focal loss of the heat plus the logarithmic IoU of the boxes predicted near the centre."""
        heat, reach = net(batch["pictures"])
        return focal(heat, batch["heat"]) + box_loss(reach, batch["reach"], batch["heat"])

    def validate(self, net: nn.Module) -> Mapping[str, float]:
        """Recall and mean IoU of the highest peak where there is a grab, and how high it is where there is none."""
        truth = self.validation.boxes
        scores, boxes = _highest(net, self.validation.pictures)
        there = np.isfinite(truth[:, 0])
        overlap = iou(boxes[there], truth[there])
        empty = float(scores[~there].max(initial=0.0))
        mean = float(overlap.mean()) if there.any() else 0.0
        found = float((overlap >= 0.5).mean()) if there.any() else 0.0
        return {"mean_iou": mean, "recall": found, "highest_on_empty": empty, SCORE: mean + found}


def _highest(net: nn.Module, small: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Scores (n,) and boxes (n, 4) of the highest peak in each small picture."""
    device = next(net.parameters()).device
    scores, boxes = [], []
    for start in range(0, len(small), _BATCH):
        heat, reach = net(torch.from_numpy(np.array(small[start : start + _BATCH])).to(device))
        best = heat.flatten(1).argmax(1)
        scores.append(heat.flatten(1).gather(1, best[:, None])[:, 0].sigmoid().cpu().numpy())
        edges = reach.flatten(2).gather(2, best[:, None, None].expand(-1, 4, 1))[..., 0].cpu().numpy()
        row, column = np.divmod(best.cpu().numpy(), heat.shape[-1])
        middle = (np.stack([column, row, column, row], -1) + 0.5) * STRIDE
        boxes.append(middle + edges * [-1, -1, 1, 1])
    return np.concatenate(scores).astype(float), np.concatenate(boxes).astype(float)


def target(box: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Heat (rows, columns), 1 in the cell of the centre, and distances to the edges (4, rows, columns), px."""
    rows, columns = COARSE_HEIGHT // STRIDE, COARSE_WIDTH // STRIDE
    if not np.isfinite(box[0]):
        return np.zeros((rows, columns), np.float32), np.ones((4, rows, columns), np.float32)
    x, y = (np.arange(columns) + 0.5)[None] * STRIDE, (np.arange(rows) + 0.5)[:, None] * STRIDE
    u, v = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    across, down = (max(extent / 10, 0.7 * STRIDE) for extent in (box[2] - box[0], box[3] - box[1]))
    heat = np.exp(-0.5 * (((x - u) / across) ** 2 + ((y - v) / down) ** 2))
    heat[min(int(v / STRIDE), rows - 1), min(int(u / STRIDE), columns - 1)] = 1
    reach = np.stack(np.broadcast_arrays(x - box[0], y - box[1], box[2] - x, box[3] - y))
    return heat.astype(np.float32), np.maximum(reach, 1.0).astype(np.float32)


def focal(logits: Tensor, wanted: Tensor) -> Tensor:
    """CenterNet's focal loss (Zhou et al. 2019, eq. 1), by picture."""
    p = logits.sigmoid()
    on = -nn.functional.logsigmoid(logits) * (1 - p) ** 2 * (wanted == 1)
    off = -nn.functional.logsigmoid(-logits) * p**2 * (1 - wanted) ** 4
    return (on + off).sum() / len(logits)


def box_loss(reach: Tensor, wanted: Tensor, heat: Tensor) -> Tensor:
    """−log IoU (Yu et al. 2016, UnitBox) near the centres."""
    weight = heat * (heat > _NEAR)
    inter = torch.minimum(reach, wanted)
    overlap = (inter[:, 0] + inter[:, 2]) * (inter[:, 1] + inter[:, 3])
    areas = [(r[:, 0] + r[:, 2]) * (r[:, 1] + r[:, 3]) for r in (reach, wanted)]
    loss = -torch.log(overlap / (areas[0] + areas[1] - overlap))
    return (loss * weight).sum() / weight.sum().clamp(min=1.0)


def _shifted(picture: Picture, box: Array, rng: np.random.Generator) -> tuple[Picture, Array]:
    """Zoom and shift a picture, unless that would push its box out."""
    if rng.random() < 0.3:
        return picture, box
    zoom = np.exp(rng.uniform(-0.3, 0.3))
    shift = rng.uniform(-0.15, 0.15, 2) * _SIZE + (1 - zoom) * _SIZE / 2
    moved = box
    if np.isfinite(box[0]):
        corners = box.reshape(2, 2) * zoom + shift
        clipped = np.clip(corners, 0, _SIZE)
        if np.prod(clipped[1] - clipped[0]) < _LEFT * np.prod(corners[1] - corners[0]):
            return picture, box
        moved = clipped.ravel()
    # OpenCV counts from the middle of the first pixel.
    affine = np.array([[zoom, 0, shift[0] + zoom / 2 - 0.5], [0, zoom, shift[1] + zoom / 2 - 0.5]])
    grey = (int(rng.integers(256)),) * 3
    size = (picture.shape[1], picture.shape[0])
    return np.asarray(cv2.warpAffine(picture, affine, size, flags=cv2.INTER_LINEAR, borderValue=grey)), moved
