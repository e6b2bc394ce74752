"""What verify learns: whether a box holds the grab, in a crop that shows more of what is around it.

Grabs that other cranes have parked look like the one that hangs, above all if both are of kinds never shown. What
distinguishes them does not depend on the kind: the ropes end at the grab that hangs. The crops of refine and settle end
close to the box, and show little of the ropes.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, normalize

from simgrab.dataset import datasets
from simgrab.instrument.detect.boxes import iou
from simgrab.instrument.detect.bundled import PASSES, VERIFY, GrabDetector
from simgrab.instrument.detect.patches import REFINE_SIZE, VERIFY_ROOM, VERIFY_SIZE, Patch
from simgrab.instrument.net import open_net
from simgrab.io.files import sha256
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.training import loop
from simgrab.training.card import Card
from simgrab.training.copies import Batch
from simgrab.training.detector import cache, evaluate, export, refine
from simgrab.training.detector.augment import Dirt, turn
from simgrab.training.detector.nets import Refine, Verify
from simgrab.training.detector.refine import CROP, ROOM, Crops, CropTask, Example
from simgrab.training.detector.settings import has_half_units
from simgrab.training.detector.start import begun, some_examples
from simgrab.training.detector.train import NETS
from simgrab.training.folder import check, claim
from simgrab.training.loop import SCORE
from simgrab.training.recipe import TrainingRecipe

TASK = "Crop around a found box and its surroundings in; whether the grab is there out."
_TIMES = 2  # examples of each frame: of the grab, and of other things
_SUSPECT = 0.015  # heat above which a candidate is refined
_SAME = 0.7  # IoU above which two boxes are one
_SCALE = 0.05  # of the crop's side, standard deviation of its logarithm
_SHIFT = 0.03  # of the box's longer side, standard deviation
_ROPES = 0.5  # weight of the ropes' direction in the loss
_LEAST_WAY = 0.01  # of a box's longer side: from there on a twentieth of the ropes has a direction
_NEAR = 1e-4  # bound of probabilities in the score


def recipe(*, quick: bool = False, **changes: Any) -> TrainingRecipe:
    """Set verify's recipe; ``changes`` are other settings, by name."""
    return replace(
        TrainingRecipe(epochs=4 if quick else 12, rate=1e-3, half=has_half_units(changes.get("device", "cpu"))),
        **changes,
    )


class ContextTask(CropTask[Example]):
    """Verify's task (`simgrab.training.loop.Task`).

    Parameters
    ----------
    train, validation : sequences of Crops
    """

    def __init__(self, train: Sequence[Crops], validation: Sequence[Crops]) -> None:
        super().__init__(_listed(train), _listed(validation), _learned, "verifying")

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Cross entropy of the presence, and how far the ropes' direction is off: so that ropes are looked for."""
        out, present = net(batch["crops"]), batch["present"]
        off = 1 - (normalize(out[:, 1:], dim=1, eps=1e-3) * batch["ropes"]).sum(1)
        known = (batch["ropes"] != 0).any(1).float()
        astray = (off * known).sum() / known.sum().clamp(min=1.0)
        return binary_cross_entropy_with_logits(out[:, 0], present) + _ROPES * astray

    def validate(self, net: nn.Module) -> Mapping[str, float]:
        """Share of crops classified correctly, and the cross entropy."""
        if not self._validation:
            return {SCORE: 0.0}
        device = next(net.parameters()).device
        crops = torch.split(self._validation["crops"], 64)
        out = torch.cat([net(some.to(device)).cpu() for some in crops])
        there, ropes = self._validation["present"], self._validation["ropes"]
        presence = out[:, 0].sigmoid().clamp(_NEAR, 1 - _NEAR)
        entropy = float(-(there * presence.log() + (1 - there) * (1 - presence).log()).mean())
        known = (ropes != 0).any(1)
        cosine = (normalize(out[known, 1:], dim=1) * ropes[known]).sum(1)
        return {
            "told_apart": float(((presence > 0.5) == (there == 1)).float().mean()),
            "ropes_within_15_deg": float((cosine > np.cos(np.radians(15))).float().mean()) if known.any() else 0.0,
            SCORE: -entropy,
        }


def _listed(sets: Sequence[Crops]) -> list[Example]:
    """All crops of the grab and of other things."""
    return [
        Example(crops, i, slot, frame.labelled and slot == 0)
        for crops in sets
        for i, frame in enumerate(crops.frames)
        for slot in (0, 1)
    ]


def _learned(example: Example, rng: np.random.Generator, dirt: Dirt | None) -> dict[str, NDArray[np.generic]]:
    """Cut one crop; without dirt as it is seen at work, and not turned."""
    picture, inside = example.crops.part(example.frame, example.slot, _window(rng), VERIFY_SIZE)
    way = _ropes(example)
    if dirt:
        laid = turn(rng, quarters=True)
        picture, inside = dirt(laid.picture(picture), rng), laid.picture(inside)
        way = laid.points(way + 0.5) - 0.5
    return {
        "crops": np.concatenate([picture, inside[..., None]], axis=-1),
        "present": np.array(example.there, np.float32),
        "ropes": way.astype(np.float32),
    }


def _ropes(example: Example) -> Array:
    """Give the unit direction in which the ropes leave the grab; 0 where there is none, or it is seen from above."""
    row = example.row
    box = labels.box(row)
    if not example.there or box is None:
        return np.zeros(2)
    way = labels.up_the_ropes(row)
    length = float(np.linalg.norm(way))
    return way / length if length > _LEAST_WAY * float((box[2:] - box[:2]).max()) else np.zeros(2)


def _window(rng: np.random.Generator) -> Patch:
    """Draw what is cut out of a cached crop, in its own pixels: a box as refine may predict it, with room around it."""
    longest = CROP / ROOM
    side = min(round(VERIFY_ROOM * longest * float(np.exp(rng.normal(0, _SCALE)))), CROP)
    shifts = rng.normal(0, _SHIFT, 2) * longest
    x, y = (int(np.clip(round((CROP - side) / 2 + shift), 0, CROP - side)) for shift in shifts)
    return Patch(x, y, x + side, y + side)


def train_verify(
    paths: Sequence[str | Path], detector: str | Path, out: str | Path, settings: TrainingRecipe, *,
    resume: bool = False, watch: Callable[[str], cache.Progress] | None = None,
    report: Callable[[loop.TrainingReport], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Train verify for a trained detector, on what this takes for the grab.

    Parameters
    ----------
    paths : sequence of paths
        Datasets that the detector has not learned; frames of the split ``train`` are learned from, those of ``val``
        choose the epoch and the presence threshold.
    detector : path
        Folder of the other nets.
    out : path
        Gets these nets with their cards, verify, its card and checkpoint, and a cache that may be deleted.
    settings : TrainingRecipe
    resume : bool
        Go on with an interrupted training of the same recipe and datasets.
    watch, report : callable, optional
        As those of `simgrab.training.detector.train.train` and `simgrab.training.loop.train`.

    Returns
    -------
    dict
        Figures of all four nets on the validation frames.

    Raises
    ------
    DatasetError, DetectorError, TrainingError
    """
    out, detector = Path(out), Path(detector)
    check(out, resume=resume)
    sets, nets = datasets.read_all(paths, "train", "val"), GrabDetector(detector)
    step = watch or (lambda _: lambda _done, _total: None)
    begin = _start(detector)
    names = dict.fromkeys([*(f"{name}.onnx" for name in NETS), begin.name])
    with claim(out, resume=resume):
        digest = hashlib.sha256(
            "".join([datasets.digest(sets), *(sha256(detector / name) for name in names)]).encode()
        ).hexdigest()
        chosen = {name: cache.frames(sets, name) for name in ("train", "val")}
        crops = {}
        for name, some in chosen.items():
            folder, twice = out / "cache" / f"{name}-{digest[:16]}", [*some] * _TIMES
            split: list[list[Array]] = [[] for _ in twice]  # crops in the cache need none
            if not cache.is_built(folder):
                boxes = suspects(nets, some, step(f"detecting in {name} images"))
                split = [found[half::_TIMES] for half in range(_TIMES) for found in boxes]
            crops[name] = refine.crops(folder, twice, split, seed=settings.seed, progress=step(f"cutting {name} crops"))
        task = ContextTask([crops["train"]], [crops["val"]])
        (out / "verify").mkdir(exist_ok=True)
        trained = loop.train(
            functools.partial(_begun, begin, task),
            task,
            settings,
            out / "verify",
            data=digest,
            resume=resume,
            report=report,
        )
        example = torch.zeros((1, VERIFY_SIZE, VERIFY_SIZE, 4), dtype=torch.uint8)
        export.export(trained.net, example, ["verdict"], out / "verify.onnx", {"task": VERIFY})
        figures = _assemble(out, detector, chosen["val"], step("detecting with verify"))
        Card(
            name="verify", task=TASK, data=tuple(one.data for one in sets), examples=trained.examples,
            recipe=dataclasses.asdict(settings), epochs=trained.epochs, seconds=trained.seconds,
            metrics={"alone": trained.figures, "best_epoch": trained.epoch} | figures, started_from=sha256(begin),
        ).save(out / "verify.onnx")  # fmt: skip
    return figures


def _start(detector: Path) -> Path:
    """File of the net whose weights verify begins with: a detector's verify, or where it has none its refine."""
    verified = open_net(detector / "settle.onnx").facts.get("verified") is True
    return detector / ("verify.onnx" if verified else "refine.onnx")


def _begun(begin: Path, task: ContextTask) -> Verify:
    """Build verify with the weights of a verify, or with the stages of a refine."""
    some = some_examples(task)["crops"]
    if begin.stem == "verify":
        result = begun(lambda: Verify(Refine()), begin, some)
        assert isinstance(result, Verify)
        return result
    shrunk = [cv2.resize(crop, (REFINE_SIZE, REFINE_SIZE), interpolation=cv2.INTER_AREA) for crop in some.numpy()]
    refined = begun(Refine, begin, torch.from_numpy(np.stack(shrunk)))
    assert isinstance(refined, Refine)
    return Verify(refined)


def _assemble(
    out: Path, detector: Path, val: Sequence[cache.TrainingFrame], progress: cache.Progress
) -> dict[str, Any]:
    """Put the other nets beside verify, with a presence threshold for all together; figures on validation frames."""
    facts = open_net(detector / "settle.onnx").facts | {"verified": True}
    export.copy(NETS, detector, out)
    settings = GrabDetector(detector).settings

    def thresholded(presence: float) -> None:
        changed = msgspec.structs.replace(settings, least_presence=presence)
        export.restated(out / "settle.onnx", facts | {"settings": msgspec.structs.asdict(changed)})

    thresholded(0.0)
    seen = evaluate.watch(GrabDetector(out), val, progress)
    presence = round(evaluate.least_presence(seen), 4)
    thresholded(presence)
    return evaluate.metrics(evaluate.by(presence, seen))


def suspects(
    detector: GrabDetector, frames: Sequence[cache.TrainingFrame], progress: cache.Progress | None = None
) -> list[list[Array]]:
    """Boxes that a detector may take for the grab in each frame, px of the picture, the most present first.

    They are its candidates, refined once, and as often as `GrabDetector` refines them again; of those that are nearly
    the same, the first.
    """
    result = []
    for frame in frames:
        picture = frame.picture()
        places = [one.box for one in detector.candidates(picture) if one.heat >= _SUSPECT]
        found: list[tuple[float, Array]] = []
        for done in range(PASSES if places else 0):
            refined = detector.refine(picture, places)
            places = list(refined.boxes)
            if done in (0, PASSES - 1):
                found += zip(refined.presence, refined.boxes, strict=True)
        boxes: list[Array] = []
        for _, box in sorted(found, key=lambda one: -one[0]):
            if all(iou(box, other) < _SAME for other in boxes):
                boxes.append(box)
        result.append(boxes)
        if progress:
            progress(len(result), len(frames))
    return result
