"""What the reader learns: every digit as often, wherever it stands and whatever has happened to it."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from simgrab.errors import DatasetError
from simgrab.instrument.read.crops import Crops
from simgrab.instrument.read.reader import HIGHEST_THRESHOLD, NO_DIGIT
from simgrab.model.rng import stream
from simgrab.training.copies import Batch
from simgrab.training.loop import SCORE
from simgrab.training.reader.augment import altered, ghostly, plain, torn
from simgrab.training.reader.cells import Cells

TORN_SHARE = 0.04  # of the digits learned from, made into torn ones
GHOST_SHARE = 0.2  # of the digits learned from, with a part of another one left in them
ROUNDS = 8  # alterations of each validation cell
REFUSED = 1e-4  # share of altered digits that the threshold may refuse
LEAST_THRESHOLD = 0.8


class Digits:
    """Cells as a task of `simgrab.training.loop`.

    Attributes
    ----------
    crops, digits, weather : ndarray, shapes (n, 1, 32, 32), (n,), (n,)
        The validation cells, as they lie and altered `ROUNDS` times: by the seed, the same in every epoch.
    """

    def __init__(self, train: Cells, val: Cells, seed: int) -> None:
        self._cells = train
        self._order = _balanced(train.digits)
        # First and last-plus-one index of the cells of each cell's picture.
        self._first, self._last = (np.searchsorted(train.frames, train.frames, end) for end in ("left", "right"))
        crops = [plain(box) for box in val.boxes]
        for k in range(ROUNDS):
            rng = stream(seed, k, "validation")
            crops += [altered(box, rng) for box in val.boxes]
        self.crops, self.digits = np.stack(crops)[:, None], np.tile(val.digits, 1 + ROUNDS)
        self.weather = np.tile(np.array(val.weather)[val.frames], 1 + ROUNDS)

    @property
    def examples(self) -> int:
        """Cells, the rarer digits counted again until all are as many."""
        return len(self._order)

    def batch(self, chosen: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Alter the chosen cells."""
        crops, digits = zip(*(self._example(int(i), rng) for i in self._order[chosen]), strict=True)
        return {"crops": torch.from_numpy(np.stack(crops)[:, None]), "digits": torch.tensor(digits)}

    def _example(self, i: int, rng: np.random.Generator) -> tuple[Crops, int]:
        box, digit = self._cells.boxes[i], int(self._cells.digits[i])
        if digit != NO_DIGIT and (chance := rng.random()) < TORN_SHARE + GHOST_SHARE:
            other = int(rng.integers(self._first[i], self._last[i]))
            if self._cells.digits[other] not in (digit, NO_DIGIT):
                if chance < TORN_SHARE:
                    return altered(torn(box, self._cells.boxes[other], rng), rng), NO_DIGIT
                box = ghostly(box, self._cells.boxes[other], rng)
        return altered(box, rng), digit

    def loss(self, net: nn.Module, batch: Batch) -> Tensor:
        """Cross entropy."""
        return functional.cross_entropy(net(batch["crops"]), batch["digits"])

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Shares of altered cells with and without a digit read right, and the score: less the mean cross entropy."""
        device = next(net.parameters()).device
        logits = torch.cat([net(part.to(device)).cpu() for part in torch.split(torch.from_numpy(self.crops), 4096)])
        digits = torch.from_numpy(self.digits)
        right = (logits.argmax(1) == digits).numpy()
        shown = self.digits != NO_DIGIT
        shares = {"digits_right": right[shown], "no_digits_right": right[~shown]}
        return {SCORE: -float(functional.cross_entropy(logits, digits))} | {
            name: float(some.mean()) for name, some in shares.items() if len(some)
        }


def threshold(probabilities: Crops, digits: NDArray[np.int64]) -> float:
    """Confidence below which a digit is refused.

    It refuses 1 in 10,000 of the validation digits, most of them altered, that are read right, and is
    `LEAST_THRESHOLD` at least: digits of an unknown font are rather refused than misread.

    Parameters
    ----------
    probabilities : ndarray, shape (n, 11)
    digits : ndarray of int, shape (n,)
    """
    right = (probabilities.argmax(1) == digits) & (digits != NO_DIGIT)
    if not right.any():
        return LEAST_THRESHOLD
    sure = float(np.quantile(probabilities[right].max(1), REFUSED))
    return min(max(sure, LEAST_THRESHOLD), HIGHEST_THRESHOLD)


def _balanced(digits: NDArray[np.int64]) -> NDArray[np.int64]:
    """List indices in which every digit is as frequent as the commonest, and "no digit" up to twice as frequent."""
    most = np.bincount(digits[digits != NO_DIGIT]).max()
    by_class = [np.flatnonzero(digits == digit) for digit in range(NO_DIGIT)]
    missing = [str(digit) for digit, members in enumerate(by_class) if not len(members)]
    if missing:
        raise DatasetError(f"no training frame shows the digit {', '.join(missing)}; render more frames")
    none = np.flatnonzero(digits == NO_DIGIT)
    spread = np.linspace(0, len(none) - 1, min(len(none), 2 * most)).astype(np.int64)
    return np.concatenate([*(np.resize(members, most) for members in by_class), none[spread]])
