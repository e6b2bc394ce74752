"""What settle learns: where the grab's centre is and how it is yawed, in a crop that refine has turned level.

It begins with refine's weights. With size, place and yaw taken out of the crop only small corrections are left to tell,
and the centre is told to about half of refine's error.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import normalize

from simgrab import labels
from simgrab.instrument.detect.patches import LEVEL_ROOM, REFINE_SIZE, Level, mask, turned
from simgrab.records import Truth
from simgrab.rng import stream
from simgrab.training.detector.augment import Dirt, turn
from simgrab.training.detector.nets import CENTRE, YAW
from simgrab.training.detector.refine import CROP, Crops, answers, lost, stack
from simgrab.training.loop import SCORE, Batch

# How far refine may be off: centre in shares of the box's longer side, yaw in rad, side as a logarithm; mostly little,
# at times much.
_MISS, _FAR_MISS, _FAR = 0.01, 0.06, 0.1
_LEAN, _ANY_LEAN, _ANY = 0.045, np.pi / 2, 0.05
_SCALE = 0.03


def learner(refined: nn.Module) -> nn.Module:
    """Copy a trained refine, to learn further."""
    return copy.deepcopy(refined).requires_grad_(True)


class Settling:
    """Settle's task (`simgrab.training.loop.Task`)."""

    def __init__(self, train: Crops, validation: Crops) -> None:
        self.train, self._shown, self._dirt = train, _shown(train), Dirt()
        rng = stream(0, 0, "settling")
        examples = [_example(validation, i, rng, None) for i in _shown(validation)]
        self._validation = stack(examples) if examples else {}

    @property
    def examples(self) -> int:
        """Number of training frames that show the grab."""
        return len(self._shown)

    def batch(self, chosen: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Turn crops level anew, as refine might have said, augmented."""
        return stack([_example(self.train, self._shown[i], rng, self._dirt) for i in chosen])

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Compose the loss of centre, yaw and their scales."""
        return lost(net, batch)

    def validate(self, net: nn.Module) -> Mapping[str, float]:
        """Medians of the centre's error, in shares of the box's longer side, and of the yaw's, rad."""
        batch = self._validation
        if not batch:
            return {SCORE: 0.0}
        out = answers(net, batch)
        miss = torch.linalg.vector_norm(out[:, CENTRE] - batch["places"][:, CENTRE], dim=1) * LEVEL_ROOM
        cosine = (normalize(out[:, YAW], dim=1) * batch["turned"]).sum(1).clamp(-1, 1)
        figures = {"centre_error": float(miss.median()), "centre_error_95": float(miss.quantile(0.95))}
        return figures | {"yaw_error": float(torch.arccos(cosine).median()) / 2, SCORE: 1 - float(miss.mean())}


def _shown(crops: Crops) -> list[int]:
    """Numbers of the frames that show the grab and its centre, or could."""
    return [
        i for i, frame in enumerate(crops.frames)
        if frame.labelled and np.isfinite(labels.centre(frame.row)).all()
    ]  # fmt: skip


def _example(crops: Crops, i: int, rng: np.random.Generator, dirt: Dirt | None) -> dict[str, NDArray[np.generic]]:
    """Turn one cached crop level; without dirt as it is seen at work, and not turned further."""
    row, patch = crops.frames[i].row, crops.patches[i][0]
    level = _level(row, rng)
    inside = mask(row.width_px, row.height_px, patch.corner, patch.size, CROP)
    whole = np.concatenate([np.asarray(crops.crops[i, 0]), inside[..., None]], axis=-1)
    cut = turned(whole, patch, level, REFINE_SIZE)
    places, lean = np.zeros((3, 2)), labels.yaw(row) - level.angle
    places[2] = level.to_shares(labels.centre(row))
    if dirt:
        laid = turn(rng, quarters=False)
        cut = laid.picture(np.concatenate([dirt(cut[..., :3], rng), cut[..., 3:]], axis=-1))
        places[2], lean = laid.points(places[2]), laid.angle(lean)
    return {
        "crops": np.ascontiguousarray(cut),
        "places": places.ravel().astype(np.float32),
        "known": np.array([0, 0, 0, 0, 1, 1], np.float32),
        "turned": np.array([np.cos(2 * lean), np.sin(2 * lean)], np.float32),
        "present": np.array(1, np.float32),
    }


def _level(row: Truth, rng: np.random.Generator) -> Level:
    """Draw where refine might say that a grab is."""
    box = labels.box(row)
    assert box is not None
    longest = float((box[2:] - box[:2]).max())
    far, any_way = rng.random(2) < (_FAR, _ANY)
    miss = rng.uniform(-_FAR_MISS, _FAR_MISS, 2) if far else rng.normal(0, _MISS, 2)
    lean = rng.uniform(-_ANY_LEAN, _ANY_LEAN) if any_way else rng.normal(0, _LEAN)
    side = LEVEL_ROOM * longest * np.exp(rng.normal(0, _SCALE))
    return Level(labels.centre(row) + longest * miss, float(side), labels.yaw(row) + float(lean))
