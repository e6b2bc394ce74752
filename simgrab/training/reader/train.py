"""From datasets to a reader: weights, threshold and card."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from simgrab.dataset import datasets as data
from simgrab.instrument.read.crops import INPUT_PX, MARGIN
from simgrab.instrument.read.reader import METADATA, NO_DIGIT, Reader
from simgrab.training import loop
from simgrab.training.card import Card
from simgrab.training.device import named, out_of_memory
from simgrab.training.export import export
from simgrab.training.folder import check, claim
from simgrab.training.reader.cells import gather
from simgrab.training.reader.lenet import LeNet5
from simgrab.training.reader.task import Digits, threshold
from simgrab.training.recipe import TrainingRecipe

NAME = "reader"
TASK = (
    "Reads the display's digits: LeNet-5 over grey crops of 32 × 32 px, one for each cell with an eighth of it around; "
    "out come the probabilities of 0 … 9 and of no digit. Torn displays were left out; torn digits were made of whole "
    "ones and taught as no digit."
)
# One thread: so small a net gains nothing by two.
RECIPE = TrainingRecipe(epochs=20, batch=128, rate=3e-3, weight_decay=0.01, average=0.995, patience=8, threads=1)
QUICK_EPOCHS = 6


def train_reader(
    paths: Sequence[str | Path],
    out: Path,
    recipe: TrainingRecipe = RECIPE,
    *,
    resume: bool = False,
    report: Callable[[loop.TrainingReport], None] = lambda _: None,
) -> Card:
    """Train a reader on rendered datasets and write ``reader.onnx`` with its card.

    Parameters
    ----------
    paths : sequence of path
        Datasets with a display, as `simgrab render` writes them. Their train split is learned from; on their val split
        the best epoch is chosen and the threshold set.
    out, recipe, resume, report
        As those of `simgrab.training.loop.train`.

    Raises
    ------
    DatasetError, TrainingError
    """
    check(out, resume=resume)
    found = data.read_all(paths, "train", "val")
    named(recipe.device)  # or refused before anything is written
    with claim(out, resume=resume):
        with out_of_memory(recipe):
            task = Digits(gather(found, "train", recipe.seed), gather(found, "val", recipe.seed), recipe.seed)
        trained = loop.train(LeNet5, task, recipe, out, data=data.digest(found), resume=resume, report=report)
        probabilities = torch.cat([trained.net(torch.from_numpy(part)) for part in np.array_split(task.crops, 16)])
        least = threshold(probabilities.softmax(1).detach().numpy(), task.digits)
        path = out / f"{NAME}.onnx"
        whole, example = nn.Sequential(trained.net, nn.Softmax(dim=1)).eval(), torch.zeros(8, 1, INPUT_PX, INPUT_PX)
        facts = {"threshold": least, "margin": MARGIN}
        export(whole, example, "crops", ["probabilities"], path, facts, key=METADATA)
        card = Card(
            NAME, TASK, tuple(dataset.data for dataset in found), task.examples, vars(recipe), trained.epochs,
            trained.seconds, _metrics(Reader(path), task) | {"best_epoch": trained.epoch},
        )  # fmt: skip
        card.save(path)
        return card


def _metrics(reader: Reader, task: Digits) -> dict[str, Any]:
    """Score the exported reader, with its threshold, on the validation cells."""
    probabilities = np.concatenate([reader.probabilities(part) for part in np.array_split(task.crops, 16)])
    best = probabilities.argmax(1)
    shown = task.digits != NO_DIGIT
    read = (best != NO_DIGIT) & (probabilities.max(1) >= reader.threshold)
    wrong = read & (best != task.digits)

    def counts(which: NDArray[np.bool_]) -> dict[str, int]:
        some = shown & which
        return {"digits": int(some.sum()), "wrong": int((wrong & some).sum()), "refused": int((~read & some).sum())}

    return {
        "threshold": reader.threshold,
        **{name if name == "digits" else f"digits_{name}": value for name, value in counts(shown).items()},
        "no_digits": int((~shown).sum()),
        "no_digits_read": int((wrong & ~shown).sum()),
        "by_weather": {str(name): counts(task.weather == name) for name in np.unique(task.weather)},
    }
