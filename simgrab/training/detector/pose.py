"""What the pose net learns: whether a crop shows the grab, its edges, centre and yaw, and how sure each is."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, normalize

from simgrab.instrument.detect.boxes import about, covered, iou
from simgrab.instrument.detect.patches import GREY, POSE_SIZE, Patch, Picture, around, as_bytes, cut, mask, places
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.training.copies import Batch
from simgrab.training.detector import cache
from simgrab.training.detector.augment import Dirt, turn
from simgrab.training.detector.nets import (
    BEYOND,
    CELL,
    CENTRE,
    CENTRE_SCALES,
    EDGE_SCALES,
    EDGES,
    PRESENCE,
    YAW,
    YAW_SCALE,
    Pose,
)  # fmt: skip
from simgrab.training.loop import SCORE

CROP = 384  # px of a cached crop
ROOM = 3.0  # its side over the box's longer one
# A learned crop's side over the box's longer one: around the closer crop of the detector, and around its first.
_CLOSE_SHARE, _CLOSE, _ZOOM = 0.4, (1.2, 1.65), (1.6, 2.7)
_SHIFT = 0.25  # of the longer side, at most
# Where the coarse net takes a part of the grab for all of it, or what is around it for a part, a crop is cut like that.
_FAR_SHARE, _FAR_ZOOM, _FAR_SHIFT = 0.25, (1.0, ROOM), 0.4
# Swings beyond 10° on short ropes reach the picture's edge: in this share of the crops it cuts so much of the box off.
_CUT_SHARE, _CUT = 0.25, (0.05, 0.55)
_OTHERS = 0.25  # share of examples of frames with a grab that show something else
_TRIES = 50  # to draw a place of something else
_WEIGHTS = (1.0, 1.0, 1.0, 1.0, 2.0, 2.0)  # of the edges, and of the grab centre, which angles are computed from
_SURPRISE = 10.0  # scales; of Laplace's errors 1 in 20,000 is greater
_APART = 0.1  # of the smaller of two boxes, covered by the other: from there on both show the same
FARTHEST = 1 + (BEYOND - 1) * CELL / POSE_SIZE  # share of a crop in which a position can be predicted
_OUTERMOST = 1 + (BEYOND - 2) * CELL / POSE_SIZE  # at which the net has an edge that lies farther out


@dataclass(frozen=True, eq=False)
class Crops:
    """Two crops of each frame, (n, 2, CROP, CROP, 3): of the grab, where there is one, and of something else."""

    crops: NDArray[np.uint8]
    patches: list[list[Patch]]  # what they show of the picture
    frames: Sequence[cache.TrainingFrame]


def crops(
    folder: Path,
    chosen: Sequence[cache.TrainingFrame],
    suspects: Sequence[Sequence[Array]],
    *,
    seed: int,
    progress: cache.Progress | None = None,
) -> Crops:
    """Cut crops, or find them cut in ``folder``.

    Parameters
    ----------
    suspects : sequence of sequences of ndarray, shape (4,)
        Boxes of each frame, px, that the coarse net took for the grab; what is none of it becomes a hard example.
    seed : int
        Of the places that are cut where nothing was suspected.
    """
    boxes = [frame.box for frame in chosen]
    longest = [(box[2:] - box[:2]).max() for box in boxes if box is not None] or [300.0]

    def make(i: int, picture: Picture) -> tuple[Picture, Sequence[Patch]]:
        rng, truth = stream(seed, i, "negatives"), boxes[i]
        others = [around(b, ROOM) for b in suspects[i] if truth is None or apart(around(b, 1.0).box, truth)]
        others = [others[k] for k in rng.permutation(len(others))]  # frames of a world suspect the same places
        while len(others) < 2:
            others.append(_anywhere(picture, longest, truth, rng))
        patches = [others[1] if truth is None else around(truth, ROOM), others[0]]
        return np.stack([cut(picture, patch, CROP, CROP) for patch in patches]), patches

    cut_out, patches = cache.build(folder, chosen, (2, CROP, CROP, 3), make, progress)
    return Crops(cut_out, patches, chosen)


def apart(box: Array, truth: Array) -> bool:
    """Whether a box is of something else than a labelled one; that of a place too great holds the grab, and is not."""
    return float(covered(box, truth)) < _APART


def _anywhere(picture: Picture, longest: Sequence[float], truth: Array | None, rng: np.random.Generator) -> Patch:
    """Draw a patch, of the size that a grab's would have, that is not about the grab, though it may show some of it."""
    h, w = picture.shape[:2]
    for _ in range(_TRIES):
        half = float(rng.choice(longest)) / 2
        box = about(np.array([rng.uniform(0, w), rng.uniform(0, h)]), half)
        if truth is None or apart(box, truth):
            return around(box, ROOM)
    return around([w, h, w + 2 * half, h + 2 * half], ROOM)  # beyond a corner of a picture that the grab fills


class PoseTask:
    """The pose net's task (`simgrab.training.loop.Task`)."""

    def __init__(self, train: Crops, validation: Crops) -> None:
        self.train, self._dirt = train, Dirt()
        rng = stream(0, 0, "validation")
        both = itertools.product(range(len(validation.frames)), (False, True))
        self._validation = stack([_example(validation, i, other, rng, None) for i, other in both])

    @property
    def examples(self) -> int:
        """Number of training frames."""
        return len(self.train.frames)

    def batch(self, chosen: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Cut new crops, augmented, some of background."""
        return stack([_example(self.train, int(i), rng.random() < _OTHERS, rng, self._dirt) for i in chosen])

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Loss of positions, yaw, their scales and the presence, and of the maps that positions are means of."""
        assert isinstance(net, Pose)
        out, weights = net.outputs_and_weights(batch["crops"])
        return loss(out, batch) + spread(weights, batch)

    def validate(self, net: nn.Module) -> Mapping[str, float]:
        """Overlap and centre error where there is a grab, and how well its presence is predicted."""
        device = next(net.parameters()).device
        out = torch.cat([net(some.to(device)) for some in torch.split(self._validation["crops"], 64)]).cpu().numpy()
        places, known, present = (self._validation[name].numpy() for name in ("places", "known", "present"))
        correct = (out[:, PRESENCE] > 0) == (present == 1)
        whole = known[:, EDGES].all(axis=1)
        overlap = iou(out[whole, EDGES], places[whole, EDGES])
        both = known.all(axis=1)
        sides = places[both, 2:4] - places[both, :2]
        miss = np.linalg.norm(out[both, CENTRE] - places[both, CENTRE], axis=-1) / sides.max(axis=-1)
        error = float(np.median(miss)) if both.any() else 1.0
        mean = float(overlap.mean()) if whole.any() else 0.0
        score = mean + float(correct.mean()) - min(error, 1.0)
        return {"mean_iou": mean, "centre_error": error, "told_apart": float(correct.mean()), SCORE: score}


def loss(out: Tensor, batch: Batch) -> Tensor:
    """Loss of an output of `simgrab.training.detector.nets.Pose` (n, 16).

    Positions are learned by their distance alone; their error is then learned as the scale of a Laplace distribution,
    of which errors of many scales count as little more than `_SURPRISE` of them.
    """
    known = batch["known"]
    count = known.sum().clamp(min=1.0)
    miss = (out[:, :6] - batch["places"]).abs() * known
    far = (miss * known.new_tensor(_WEIGHTS)).sum() / count
    scales = torch.cat([out[:, EDGE_SCALES], out[:, CENTRE_SCALES]], 1)
    unsure = (_surprise(miss.detach(), scales) + scales) * known
    turned, there = batch["turned"], batch["present"]
    yaw_known = there * (turned != 0).any(1).float()
    unit = normalize(out[:, YAW], dim=1, eps=1e-3)
    off = (1 - (unit * turned).sum(1)) * yaw_known
    # 1 − cos δ gives |δ| where it is small, and stays finite where it is not.
    delta = torch.sqrt((2 * off).clamp(min=0.0)).detach()
    lean = (_surprise(delta, out[:, YAW_SCALE]) + out[:, YAW_SCALE]) * yaw_known
    grabs = yaw_known.sum().clamp(min=1.0)
    presence = binary_cross_entropy_with_logits(out[:, PRESENCE], there)
    return 40 * far + 0.2 * unsure.sum() / count + off.sum() / grabs + 0.05 * lean.sum() / grabs + presence


def _surprise(miss: Tensor, scales: Tensor) -> Tensor:
    """Errors in their scales, given as logarithms; beyond `_SURPRISE` of them, as slowly more as its logarithm.

    Scales that a net learned elsewhere may be far too small: the gradient would be theirs alone, and is bounded so.
    """
    ratio, most = torch.log(miss) - scales, math.log(_SURPRISE)  # logarithms, which cannot overflow
    return torch.where(ratio < most, torch.exp(ratio.clamp(max=most)), _SURPRISE * (1 + ratio - most))


def spread(weights: Tensor, batch: Batch) -> Tensor:
    """Cross entropy of the cells' weights with the two cells that a position lies between (Li et al. 2020).

    A mean can be right with its weights all over the crop; it is found sooner where they lie together.
    """
    cells = weights.shape[-1] - 2 * BEYOND
    at = (batch["places"] * cells - 0.5 + BEYOND).clamp(0, weights.shape[-1] - 1.001)
    low = at.floor().long()[..., None]
    near, far = weights.gather(-1, low)[..., 0], weights.gather(-1, low + 1)[..., 0]
    share = at - at.floor()
    entropy = -(near * (1 - share) + far * share) * batch["known"]
    return entropy.sum() / batch["known"].sum().clamp(min=1.0)


def _example(
    crops: Crops, i: int, other: bool, rng: np.random.Generator, dirt: Dirt | None
) -> dict[str, NDArray[np.generic]]:
    """Cut one example out of a cached crop; without dirt as it is seen at work, and not turned."""
    frame = crops.frames[i]
    patch, row = crops.patches[i][other], frame.row
    box = None if other else frame.box
    edges = np.array([0, 0, row.width_px, row.height_px])
    if dirt and rng.random() < _CUT_SHARE:
        edges = _nearer(edges, around(patch.box, 1 / ROOM).box if box is None else box, rng)
    seen = None if box is None else np.clip(box, np.tile(edges[:2], 2), np.tile(edges[2:], 2))
    window = _window(patch, seen, rng)
    picture = cut(np.asarray(crops.crops[i, int(other)]), window, POSE_SIZE, POSE_SIZE)
    corner, extent = patch.to_picture(window.corner / CROP), patch.size * window.size / CROP
    (width, height), first = edges[2:] - edges[:2], corner - edges[:2]
    inside = mask(width, height, first, extent, POSE_SIZE)
    # As if a whole picture ended there.
    moved = edges[:2] + edges[2:] - (row.width_px, row.height_px)
    where = places(row.width_px, row.height_px, corner - moved, extent, POSE_SIZE)
    if (width, height) != (row.width_px, row.height_px):
        share = inside[..., None] / 255
        picture = np.rint(share * picture + (1 - share) * GREY).astype(np.uint8)
    wanted, yaw = np.full(6, np.nan), 0.0
    if seen is not None:
        wanted = ((np.concatenate([seen, labels.centre(row)]).reshape(3, 2) - corner) / extent).ravel()
        yaw = labels.yaw(row)
    if dirt:
        laid = turn(rng, quarters=True)
        picture, inside = dirt(laid.picture(picture), rng), laid.picture(inside)
        where = laid.points(laid.picture(where) + 0.5) - 0.5
        wanted = np.concatenate([laid.box(wanted[:4]), laid.points(wanted[4:])])
        yaw = laid.angle(yaw)
    wanted[:4] = np.clip(wanted[:4], 1 - _OUTERMOST, _OUTERMOST)  # an edge that is farther out is looked for from there
    known = np.isfinite(wanted) & (np.abs(wanted - 0.5) < FARTHEST - 0.5)
    return {
        "crops": np.concatenate([picture, inside[..., None], as_bytes(where)], axis=-1),
        "places": np.where(known, wanted, 0).astype(np.float32),
        "known": known.astype(np.float32),
        "turned": doubled(yaw),
        "present": np.float32(frame.labelled and not other),
    }


def _nearer(edges: NDArray[np.int64], box: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw one of a picture's edges x0, y0, x1, y1 so near that it cuts a part of a box off, if it does not already."""
    result, side = edges.copy(), int(rng.integers(4))
    axis, depth = side % 2, rng.uniform(*_CUT)
    low, high = box[axis], box[axis + 2]
    if side < 2:
        result[side] = max(edges[side], round(low + depth * (high - low)))
    else:
        result[side] = min(edges[side], round(high - depth * (high - low)))
    # A box beyond the picture leaves it as it is.
    return result if result[axis] < result[axis + 2] else edges


def doubled(yaw: float) -> NDArray[np.float32]:
    """Cosine and sine of twice a yaw, rad; 0 where it is unknown, and not learned."""
    return np.nan_to_num(np.array([np.cos(2 * yaw), np.sin(2 * yaw)], np.float32))


def _window(patch: Patch, box: Array | None, rng: np.random.Generator) -> Patch:
    """Draw what is cut out of a cached crop, in its own pixels: the grab zoomed and shifted, or any such part."""
    longest, middle = CROP / ROOM, np.full(2, CROP / 2)
    if box is not None:
        corners = patch.to_shares(box.reshape(2, 2)) * CROP
        longest, middle = float((corners[1] - corners[0]).max()), corners.mean(axis=0)
    far = box is not None and rng.random() < _FAR_SHARE
    zoom = _FAR_ZOOM if far else _CLOSE if rng.random() < _CLOSE_SHARE else _ZOOM
    side = longest * np.exp(rng.uniform(*np.log(zoom)))
    if far:
        shift = rng.uniform(-_FAR_SHIFT, _FAR_SHIFT, 2) * longest
    else:
        shift = np.clip(rng.normal(0, 0.4 * _SHIFT, 2), -_SHIFT, _SHIFT) * longest
    side = min(round(side), CROP)
    x, y = (int(np.clip(round(m - side / 2), 0, CROP - side)) for m in middle + shift)
    return Patch(x, y, x + side, y + side)


def stack(examples: list[dict[str, NDArray[np.generic]]]) -> Batch:
    """Put examples together."""
    return {name: torch.from_numpy(np.stack([e[name] for e in examples])) for name in examples[0]}
