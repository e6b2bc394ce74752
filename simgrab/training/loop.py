"""The training loop: seeded, averaged, validated, and resumed as if it had never stopped.

Nothing is drawn from a running generator: the order of an epoch and the augmentation of a batch have streams of their
own (`simgrab.model.rng`), and the learning rate is a function of the step. A checkpoint therefore needs no generator's
state.
"""

from __future__ import annotations

import copy
import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

from simgrab._version import __version__
from simgrab.errors import TrainingError
from simgrab.model.rng import stream
from simgrab.training import checkpoint
from simgrab.training.copies import Batch, Copies
from simgrab.training.device import named, out_of_memory, to_device
from simgrab.training.recipe import TrainingRecipe

CHECKPOINT = "checkpoint.pt"
SCORE = "score"

_AHEAD = 2  # batches made while one is learned from


class Task(Protocol):
    """What is learned: where batches come from, what is lost on one, and how good a net is."""

    @property
    def examples(self) -> int:
        """Number of training examples."""

    def batch(self, chosen: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Make the batch of the chosen examples; all chance from ``rng``. Runs beside the learning, in a thread."""

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Mean loss over a batch, or over a part of it (`simgrab.training.copies`), a scalar."""

    def validate(self, net: nn.Module) -> Mapping[str, float]:
        """Figures on validation data; ``"score"`` among them is the network's quality, higher is better."""


@dataclass(frozen=True)
class TrainingReport:
    """How far a training is: sent after each step, with figures after each epoch."""

    epoch: int
    epochs: int
    step: int
    steps: int
    loss: float
    examples_per_s: float
    figures: Mapping[str, float]


@dataclass(frozen=True)
class Trained:
    """A trained net."""

    net: nn.Module  # averaged weights of the best epoch, on the CPU, in evaluation mode
    figures: dict[str, float]  # validation figures of that epoch
    # epoch, epochs: that epoch, and how many were run
    epoch: int
    epochs: int
    seconds: float  # wall time, interruptions left out
    examples: int  # learned from in each epoch


def train(
    build: Callable[[], nn.Module],
    task: Task,
    recipe: TrainingRecipe,
    out: Path,
    *,
    data: str = "",
    resume: bool = False,
    report: Callable[[TrainingReport], None] = lambda _: None,
    loaders: int = 0,
) -> Trained:
    """Train a net.

    On the cores of one machine the same recipe, examples and versions give the same weights, however often the training
    was killed; a GPU may sum in another order.

    Parameters
    ----------
    build : callable
        Makes the net; torch is seeded before.
    out : Path
        Folder of the checkpoint.
    data : str
        Digest of the examples; a checkpoint is not taken up with others.
    resume : bool
        Go on from the checkpoint, where there is one.
    loaders : int
        Processes that make batches, forked from this one, which a fast device waits for less; 0 makes them in a thread.
        The batches are the same.

    Raises
    ------
    TrainingError
        If memory runs out, a loss is no number, the device is missing, or the checkpoint is another training's.
    """
    if task.examples < 1:
        raise TrainingError("no training examples")
    with out_of_memory(recipe):
        run = _Run(build, task, recipe, out / CHECKPOINT, data, loaders)
        if resume and run.path.exists():
            run.restore()
        while not run.finished:
            run.epoch(report)
        return run.result()


class _Run:
    """A training under way."""

    def __init__(
        self, build: Callable[[], nn.Module], task: Task, recipe: TrainingRecipe, path: Path, data: str, loaders: int
    ) -> None:
        torch.set_num_threads(recipe.threads)
        torch.manual_seed(recipe.seed)
        self.task, self.recipe, self.path, self.loaders = task, recipe, path, loaders
        versions = {"simgrab": __version__, "torch": str(torch.__version__)}
        self.identity = dataclasses.asdict(recipe) | {"data": data} | versions
        self.device = named(recipe.device)
        self.net = build().to(self.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = AveragedModel(self.net, use_buffers=True).eval().requires_grad_(False)
        self.average.n_averaged += 1  # of the net as it was built; else the first step's weights would be copied
        self.copies = Copies(self.net, recipe.threads if self.device.type == "cpu" else 1)
        self.optimiser = torch.optim.AdamW(groups(self.net, recipe.weight_decay), lr=recipe.rate)
        self.steps = max(task.examples // recipe.batch, 1)  # an epoch; what is left over waits for another order
        self.history: list[dict[str, float]] = []
        self.best: dict[str, Tensor] = {}
        self.best_epoch, self.seconds = 0, 0.0

    @property
    def finished(self) -> bool:
        done, patience = len(self.history), self.recipe.patience
        return done >= self.recipe.epochs or bool(patience and done - self.best_epoch >= patience)

    def epoch(self, report: Callable[[TrainingReport], None]) -> None:
        start, number, losses = time.monotonic(), len(self.history), []

        def tell(step: int, loss: float, figures: Mapping[str, float]) -> None:
            speed = step * self.recipe.batch / (time.monotonic() - start)
            report(TrainingReport(number + 1, self.recipe.epochs, step, self.steps, loss, speed, figures))

        torch.manual_seed(int(stream(self.recipe.seed, number, "torch").integers(2**62)))
        self.net.train()
        for i, batch in enumerate(self._batches(number)):
            losses.append(self._step(number * self.steps + i, batch))
            tell(i + 1, losses[-1], {})
        with torch.inference_mode():
            figures = {name: float(value) for name, value in self.task.validate(self.average.module).items()}
        self.history.append({"loss": float(np.mean(losses))} | figures)
        if not self.best or figures[SCORE] > self.history[self.best_epoch - 1][SCORE]:
            self.best, self.best_epoch = copy.deepcopy(self.average.module.state_dict()), number + 1
        self.seconds += time.monotonic() - start
        self.save()
        tell(self.steps, self.history[-1]["loss"], figures)

    def _batches(self, epoch: int) -> Iterator[Batch]:
        recipe, size = self.recipe, min(self.recipe.batch, self.task.examples)
        order = stream(recipe.seed, epoch, "order").permutation(self.task.examples)

        def make(i: int) -> Batch:
            rng = stream(recipe.seed, epoch * self.steps + i, "augmentation")
            return self.task.batch(order[i * size : (i + 1) * size], rng)

        if self.loaders:
            made: DataLoader[Batch] = DataLoader(
                range(self.steps), batch_size=None, collate_fn=make, num_workers=self.loaders,  # type: ignore[arg-type]
                multiprocessing_context="fork", generator=torch.Generator(),  # not the chance that dropout goes by
            )  # fmt: skip
            threads = cv2.getNumThreads()
            cv2.setNumThreads(1)  # a fork has none of OpenCV's threads, and would wait for them for ever
            batches = iter(made)
            cv2.setNumThreads(threads)
            yield from (to_device(batch, self.device) for batch in batches)
            return
        with ThreadPoolExecutor(1) as pool:
            waiting: list[Future[Batch]] = []
            for i in range(self.steps + _AHEAD):
                if i < self.steps:
                    waiting.append(pool.submit(make, i))
                if i >= _AHEAD:
                    yield to_device(waiting.pop(0).result(), self.device)

    def _step(self, number: int, batch: Batch) -> float:
        recipe = self.recipe
        for group in self.optimiser.param_groups:
            group["lr"] = group["share"] * recipe.rate_at(number / (self.steps * recipe.epochs))
        value = self.copies.gradients(self._loss, batch)
        if not np.isfinite(value):
            raise TrainingError(f"the loss of step {number} is {value}: lower the learning rate ({recipe.rate})")
        nn.utils.clip_grad_norm_(self.net.parameters(), recipe.clip)
        self.optimiser.step()
        # Early averages forget faster, so that the first weights do not linger.
        decay = min(recipe.average, (1 + number) / (10 + number))
        self.average.multi_avg_fn = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]
        self.average.update_parameters(self.net)
        return value

    def _loss(self, net: nn.Module, batch: Batch) -> Tensor:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.recipe.half):
            return self.task.loss(net, batch)

    def save(self) -> None:
        checkpoint.save(
            self.path,
            {
                "identity": self.identity, "history": self.history, "seconds": self.seconds,
                "net": self.net.state_dict(), "average": self.average.state_dict(),
                "optimiser": self.optimiser.state_dict(), "best": self.best, "best_epoch": self.best_epoch,
            },
        )  # fmt: skip

    def restore(self) -> None:
        state: dict[str, Any] = checkpoint.load(self.path, self.identity)
        try:
            self.net.load_state_dict(state["net"])
            self.average.load_state_dict(state["average"])
        except RuntimeError:
            raise TrainingError(f"{self.path} holds another network or version: choose another --out") from None
        except (KeyError, TypeError, AttributeError) as problem:
            raise self._damaged(problem) from None
        try:
            own = self.optimiser.state_dict()["param_groups"]  # of the recipe
            self.optimiser.load_state_dict(state["optimiser"] | {"param_groups": own})
            for weight, values in self.optimiser.state.items():
                if any(value.ndim and value.shape != weight.shape for value in values.values()):
                    raise ValueError("optimiser")
            copy.deepcopy(self.average.module).load_state_dict(state["best"])
            history = [{str(name): float(value) for name, value in epoch.items()} for epoch in state["history"]]
            scores, best_epoch, seconds = [epoch[SCORE] for epoch in history], state["best_epoch"], state["seconds"]
            if not 1 <= best_epoch <= len(scores) or not isinstance(best_epoch, int):
                raise ValueError("best_epoch")
            self.seconds = float(seconds)
        except Exception as problem:  # torch's optimisers raise whatever they run into
            raise self._damaged(problem) from None
        self.history, self.best, self.best_epoch = history, state["best"], best_epoch

    def _damaged(self, problem: Exception) -> TrainingError:
        return TrainingError(f"{self.path} is damaged ({type(problem).__name__}); choose another --out")

    def result(self) -> Trained:
        self.average.module.load_state_dict(self.best)
        best = {name: value for name, value in self.history[self.best_epoch - 1].items() if name != "loss"}
        net = self.average.module.cpu().eval()
        return Trained(net, best, self.best_epoch, len(self.history), self.seconds, self.task.examples)


def groups(net: nn.Module, decay: float) -> list[dict[str, Any]]:
    """Spare biases and norms the weight decay, and let a part that states a share of the rate learn at that."""
    shares = {
        weight: cast("float", module.share)
        for module in net.modules()
        if hasattr(module, "share")
        for weight in module.parameters()
    }
    groups: dict[tuple[float, float], list[nn.Parameter]] = {}
    for weight in net.parameters():
        if weight.requires_grad:
            groups.setdefault((decay if weight.ndim >= 2 else 0.0, shares.get(weight, 1.0)), []).append(weight)
    return [{"params": weights, "weight_decay": own, "share": share} for (own, share), weights in groups.items()]
