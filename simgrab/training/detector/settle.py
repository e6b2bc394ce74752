"""What settle learns: whether it is the grab, where its centre is and how it is yawed, in a crop turned level.

It begins with refine's weights, or with those of a trained settle. With size, place and yaw taken out of the crop only
small corrections are left, and the centre is predicted with about half of refine's error; background is separated from
the grab in one pose. From frames of which boxes alone are known it learns the presence.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import normalize

from simgrab.instrument.detect.boxes import about
from simgrab.instrument.detect.bundled import Settings, read
from simgrab.instrument.detect.patches import LEVEL_ROOM, REFINE_SIZE, Level, Patch, Picture, around, mask, turned
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.truth import Boxed, Row
from simgrab.training.copies import Batch
from simgrab.training.detector import refine
from simgrab.training.detector.augment import Dirt, turn
from simgrab.training.detector.nets import CENTRE, PRESENCE, YAW
from simgrab.training.detector.refine import CROP, FARTHEST, ROOM, Crops, CropTask, answers, apart, doubled, lost
from simgrab.training.loop import SCORE

# How far refine may be off: centre in shares of the box's longer side, yaw in rad, side as a logarithm; mostly little,
# at times much.
_MISS, _FAR_MISS, _FAR = 0.01, 0.06, 0.1
_LEAN, _ANY_LEAN, _ANY = 0.045, np.pi / 2, 0.05
_SCALE = 0.03
_AS_SAID = 0.5  # share of grabs that are levelled by refine's yaw, not the true one
_WITHIN = 0.3  # shares of a level crop by which the grab's centre may lie off its middle
_OFF = 0.1  # centres so far aside in the mean, in the box's longer side, are as bad as wrong answers alone
_OTHERS = 0.8  # examples of something else, for each of the grab: those most like it
_BATCH = 512  # batch of refine, crops


def learner(refined: nn.Module) -> nn.Module:
    """Copy a trained refine, to learn further."""
    return copy.deepcopy(refined).requires_grad_(True)


@dataclass(frozen=True, eq=False)
class _Example(refine.Example):
    """A cached crop with refine's output for it: its presence and the level part."""

    presence: float
    said: Level


class PoseTask(CropTask[_Example]):
    """Settle's task (`simgrab.training.loop.Task`).

    Parameters
    ----------
    train, validation : sequences of Crops
    refined : Refine
        Trained; its answers are what settle begins with at work.
    """

    def __init__(self, train: Sequence[Crops], validation: Sequence[Crops], refined: nn.Module) -> None:
        super().__init__(_chosen(train, refined), _chosen(validation, refined), _learned, "settling")

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Compose the loss of presence, centre, yaw and their scales."""
        return lost(net, batch)

    def validate(self, net: nn.Module) -> Mapping[str, float]:
        """How well presence is predicted; medians of the centre's error (of the box's longer side) and the yaw's."""
        batch = self._validation
        if not batch:
            return {SCORE: 0.0}
        out = answers(net, batch)
        there = batch["known"][:, 4] == 1
        correct = float(((out[:, PRESENCE] > 0) == (batch["present"] == 1)).float().mean())
        if not there.any():
            return {"told_apart": correct, SCORE: correct}
        miss = torch.linalg.vector_norm(out[there, CENTRE] - batch["places"][there, CENTRE], dim=1) * LEVEL_ROOM
        cosine = (normalize(out[there, YAW], dim=1) * batch["turned"][there]).sum(1).clamp(-1, 1)
        return {
            "told_apart": correct, "centre_error": float(miss.median()), "centre_error_95": float(miss.quantile(0.95)),
            "yaw_error": float(torch.arccos(cosine).median()) / 2, SCORE: correct + 1 - float(miss.mean()) / _OFF,
        }  # fmt: skip


def _chosen(sets: Sequence[Crops], refined: nn.Module) -> list[_Example]:
    """All crops of the grab, and of the others those that refine takes for it soonest."""
    seen = [example for crops in sets for example in _examples(crops, refined)]
    grabs = [example for example in seen if example.there]
    others = sorted((example for example in seen if not example.there), key=lambda example: -example.presence)
    return grabs + others[: max(round(_OTHERS * len(grabs)), 1)]


def _examples(crops: Crops, refined: nn.Module) -> list[_Example]:
    """Run refine on the crops of each frame as in use, around a box much like find's.

    Where it comes upon the grab from beside it, that is no example of something else.
    """
    result: list[_Example] = []
    places = [(i, slot) for i in range(len(crops.frames)) for slot in (0, 1)]
    for start in range(0, len(places), _BATCH):
        some = [(i, slot, _window(crops, i, slot)) for i, slot in places[start : start + _BATCH]]
        level_crops = [turned(_whole(crops, i, slot), crops.patches[i][slot], _upright(window), REFINE_SIZE)
                 for i, slot, window in some]  # fmt: skip
        with torch.inference_mode():
            outputs = answers(refined, {"crops": torch.from_numpy(np.stack(level_crops))}).numpy()
        for (i, slot, window), out in zip(some, outputs, strict=True):
            frame = crops.frames[i]
            there = frame.labelled and slot == 0
            if there and isinstance(frame.row, Row) and not np.isfinite(labels.centre(frame.row)).all():
                continue
            one = read(out[None], [window], frame.row.width_px, frame.row.height_px)
            said, box = one.level(), labels.box(frame.row) if frame.labelled else None
            if not there and box is not None and not apart(_seen(said), box):
                continue
            result.append(
                _Example(crops, i, slot, there, float(one.presence[0]),
                         said if there else _within(said, crops.patches[i][slot]))
            )  # fmt: skip
    return result


def _seen(level: Level) -> Array:
    """Box that a level part is about, upright."""
    return about(level.middle, level.side / LEVEL_ROOM / 2)


def _window(crops: Crops, i: int, slot: int) -> Patch:
    """Crop of refine, given a box as find may predict it."""
    rng, frame, patch = stream(slot, i, "windows"), crops.frames[i], crops.patches[i][slot]
    box = labels.box(frame.row) if frame.labelled and slot == 0 else None
    if box is None:
        box = about(patch.corner + patch.size / 2, patch.size / ROOM / 2)
    longest = float((box[2:] - box[:2]).max())
    return around(
        box + np.tile(rng.normal(0, 0.04, 2) * longest, 2), Settings().room * float(np.exp(rng.normal(0, 0.06)))
    )


def _upright(window: Patch) -> Level:
    return Level(window.to_picture([0.5, 0.5]), float(window.size[0]), 0.0)


def _within(said: Level, patch: Patch) -> Level:
    """Keep a level part within what was cached of the picture, whichever way it is turned."""
    middle = patch.to_picture([0.5, 0.5])
    room = np.sqrt(2) * float((patch.size / 2 - np.abs(said.middle - middle)).min())
    if room < said.side / 3:
        return Level(middle, LEVEL_ROOM * float(patch.size[0]) / ROOM, said.angle)
    return Level(said.middle, min(said.side, room), said.angle)


def _whole(crops: Crops, i: int, slot: int) -> Picture:
    """Return a cached crop with what of it lies in the picture."""
    row, patch = crops.frames[i].row, crops.patches[i][slot]
    inside = mask(row.width_px, row.height_px, patch.corner, patch.size, CROP)
    return np.concatenate([np.asarray(crops.crops[i, slot]), inside[..., None]], axis=-1)


def _learned(example: _Example, rng: np.random.Generator, dirt: Dirt | None) -> dict[str, NDArray[np.generic]]:
    """Turn one crop level; without dirt as it is seen at work, and not turned further."""
    row, patch, level = example.row, example.crops.patches[example.frame][example.slot], _level(example, rng)
    cut = turned(_whole(example.crops, example.frame, example.slot), patch, level, REFINE_SIZE)
    places, lean = np.full((3, 2), np.nan), 0.0
    if example.there:
        places[2], lean = level.to_shares(labels.centre(row)), labels.yaw(row) - level.angle
    if dirt:
        laid = turn(rng, quarters=False)
        cut = laid.picture(np.concatenate([dirt(cut[..., :3], rng), cut[..., 3:]], axis=-1))
        places, lean = laid.points(places), laid.angle(lean)
    known = np.isfinite(places) & (np.abs(places - 0.5) < FARTHEST - 0.5)
    return {
        "crops": np.ascontiguousarray(cut),
        "places": np.where(known, places, 0).ravel().astype(np.float32),
        "known": known.ravel().astype(np.float32),
        "turned": doubled(lean),
        "present": np.array(example.there, np.float32),
    }


def _level(example: _Example, rng: np.random.Generator) -> Level:
    """Draw an output that refine may give for a crop."""
    start = _true(example) if example.there else example.said
    if example.there and rng.random() < _AS_SAID and _on(example.said, start.middle):
        start = example.said
    longest, (far, any_way) = start.side / LEVEL_ROOM, rng.random(2) < (_FAR, _ANY)
    miss = rng.uniform(-_FAR_MISS, _FAR_MISS, 2) if far else rng.normal(0, _MISS, 2)
    lean = rng.uniform(-_ANY_LEAN, _ANY_LEAN) if any_way else rng.normal(0, _LEAN)
    side = start.side * np.exp(rng.normal(0, _SCALE))
    return Level(start.middle + longest * miss, float(side), start.angle + float(lean))


def _on(level: Level, point: Array) -> bool:
    return bool((np.abs(level.to_shares(point) - 0.5) < _WITHIN).all())


def _true(example: _Example) -> Level:
    """Tell the level part around a labelled grab; of a box alone, about its middle, turned as refine said."""
    row = example.row
    box = labels.box(row)
    assert box is not None
    side = LEVEL_ROOM * float((box[2:] - box[:2]).max())
    if isinstance(row, Boxed):
        return Level((box[:2] + box[2:]) / 2, side, example.said.angle)
    return Level(labels.centre(row), side, labels.yaw(row))
