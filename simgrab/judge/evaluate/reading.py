"""Accuracy of read rope lengths: by digit and by frame, with exact intervals, and every wrong frame by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.judge.evaluate.values import Lengths, ReadingScore, Share, Wrong
from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Read:
    """A frame's display, and what was read.

    Attributes
    ----------
    frame : str
        Name of the frame.
    text, below : str
        Text of the display above and below the torn row; equal if it did not tear.
    found : str
        Text that was read; ``?`` stands for a refused digit.
    """

    frame: str
    text: str
    below: str
    found: str

    @property
    def torn(self) -> bool:
        """Whether the display shows two texts."""
        return self.text != self.below

    @property
    def refused(self) -> bool:
        """Whether any digit was refused."""
        return "?" in self.found

    @property
    def wrong(self) -> bool:
        """Whether a number was read that the display does not show; either text of a torn display is right."""
        pairs = zip(self.found.split(), self.text.split(), self.below.split(), strict=True)
        return not self.refused and any(found not in (above, below) for found, above, below in pairs)


def share(count: int, of: int) -> Share:
    """Compute a share with its exact 95 % interval (Clopper & Pearson 1934), for independent trials."""
    return Share(count, of, count / of if of else None, clopper_pearson(count, of) or (0.0, 1.0))


def score(reads: Sequence[Read], jumps: int, off_m: Array) -> ReadingScore:
    """Score frames with a display, and absolute errors of the rope's length (n,), m.

    ``jumps`` are readings that the hoist is too slow to have reached.
    """
    whole, torn = [r for r in reads if not r.torn], [r for r in reads if r.torn]
    pairs = [pair for r in whole for pair in _pairs(r)]
    answered = [(found, shown) for found, shown in pairs if found != "?"]
    refused, torn_refused = (sum(r.refused for r in some) for some in (whole, torn))
    wrong, torn_wrong = (sum(r.wrong for r in some) for some in (whole, torn))
    errors = (np.median(off_m), np.quantile(off_m, 0.95), off_m.max()) if len(off_m) else ()
    return ReadingScore(
        digits_right=share(sum(found == shown for found, shown in answered), len(answered)),
        digits_refused=share(len(pairs) - len(answered), len(pairs)),
        frames_right=share(len(whole) - refused - wrong, len(whole) - refused),
        frames_refused=share(refused, len(whole)),
        torn_right=share(len(torn) - torn_refused - torn_wrong, len(torn)),
        torn_refused=share(torn_refused, len(torn)),
        wrong=[Wrong(r.frame, f"{r.text} over {r.below}" if r.torn else r.text, r.found) for r in reads if r.wrong],
        jumps=jumps,
        length=Lengths(len(off_m), *map(float, errors)) if errors else Lengths(0, None, None, None),
    )


def _pairs(read: Read) -> Iterable[tuple[str, str]]:
    """Each digit as it was read and as it is."""
    found = [c for c in read.found if c.isdigit() or c == "?"]
    shown = [c for c in read.text if c.isdigit()]
    return zip(found, shown, strict=True)
