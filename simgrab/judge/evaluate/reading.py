"""Accuracy of read rope lengths: by digit and by frame, with exact intervals, and every wrong frame by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.judge.evaluate.values import GroupScore, Share, Wrong
from simgrab.model.records.observations import Reading


@dataclass(frozen=True)
class Read:
    """A frame's display, and its reading.

    Attributes
    ----------
    frame : str
        Name of the frame.
    group : str
        Group in which the frame is scored, e.g. its weather.
    text, below : str
        Text of the display above and below the torn row; equal if it did not tear.
    reading : Reading
    """

    frame: str
    group: str
    text: str
    below: str
    reading: Reading

    @property
    def torn(self) -> bool:
        """Whether the display shows two texts."""
        return self.text != self.below

    @property
    def wrong(self) -> bool:
        """Whether a number was read that the display does not show; either text of a torn display is right."""
        pairs = zip(self.reading.text.split(), self.text.split(), self.below.split(), strict=True)
        return self.reading.status != "refused" and any(
            found not in (above, below) for found, above, below in pairs if "?" not in found
        )


def share(count: int, of: int) -> Share:
    """Compute a share with its exact 95 % interval (Clopper & Pearson 1934), for independent trials."""
    return Share(count, of, count / of if of else None, clopper_pearson(count, of) or (0.0, 1.0))


def score(reads: Sequence[Read], group: str = "all") -> GroupScore:
    """Score frames as one group."""
    whole, torn = [r for r in reads if not r.torn], [r for r in reads if r.torn]
    pairs = [pair for r in whole for pair in _pairs(r)]
    answered = [(found, shown) for found, shown in pairs if found != "?"]
    refused, torn_refused = (sum(r.reading.status == "refused" for r in some) for some in (whole, torn))
    wrong, torn_wrong = (sum(r.wrong for r in some) for some in (whole, torn))
    return GroupScore(
        group,
        digits_right=share(sum(found == shown for found, shown in answered), len(answered)),
        digits_refused=share(len(pairs) - len(answered), len(pairs)),
        frames_right=share(len(whole) - refused - wrong, len(whole) - refused),
        frames_refused=share(refused, len(whole)),
        torn_right=share(len(torn) - torn_refused - torn_wrong, len(torn)),
        torn_refused=share(torn_refused, len(torn)),
        wrong=[
            Wrong(r.frame, r.group, f"{r.text} over {r.below}" if r.torn else r.text, r.reading.text)
            for r in reads
            if r.wrong
        ],
    )


def _pairs(read: Read) -> Iterable[tuple[str, str]]:
    """Each digit as it was read and as it is."""
    found = [c for c in read.reading.text if c.isdigit() or c == "?"]
    shown = [c for c in read.text if c.isdigit()]
    return zip(found, shown, strict=True)
