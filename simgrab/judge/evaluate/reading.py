"""How well rope lengths are read: by digit and by frame, with exact intervals, and every wrong frame by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simgrab.dataset import datasets
from simgrab.dataset.datasets import MANIFEST, Dataset
from simgrab.errors import DatasetError
from simgrab.instrument.read import Reader
from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.model import scenes
from simgrab.model.records import frame_files
from simgrab.model.records.observations import Reading
from simgrab.model.scenario import Scenario, variants
from simgrab.model.truth import Row

LARGEST_LIST = 20  # of wrong frames in a table; the JSON has all of them


@dataclass(frozen=True)
class Read:
    """A frame's display, and what was read of it.

    Attributes
    ----------
    frame : str
        Where it is from.
    group : str
        What it is scored with, e.g. its weather.
    text, below : str
        What the display shows above and below the row where it tore; the same where it did not.
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
        """Whether a number was read that the display does not show; of a torn one either text's will do."""
        pairs = zip(self.reading.text.split(), self.text.split(), self.below.split(), strict=True)
        return self.reading.status != "refused" and any(
            found not in (above, below) for found, above, below in pairs if "?" not in found
        )


@dataclass(frozen=True)
class Share:
    """So many of so many."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """The share; None of nothing."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper and Pearson's exact interval (1934) at 95 %, for independent trials."""
        return clopper_pearson(self.count, self.of) or (0.0, 1.0)


@dataclass(frozen=True)
class Score:
    """How the frames of a group were read. All but the torn ones' shares are of frames that are whole.

    Attributes
    ----------
    group : str
    digits_right : Share
        Of digits that were read, those that are what the display shows.
    digits_refused : Share
        Of all digits.
    frames_right : Share
        Of frames that were read, those with every number right that was read.
    frames_refused : Share
        Of all frames, those of which the hoist rope's number was not read.
    torn_right, torn_refused : Share
        Of torn frames: each number that was read is that above or that below; refused. The rest were read as a mixture.
    wrong : tuple of Read
        Every frame read wrong, torn or whole.
    """

    group: str
    digits_right: Share
    digits_refused: Share
    frames_right: Share
    frames_refused: Share
    torn_right: Share
    torn_refused: Share
    wrong: tuple[Read, ...] = field(default=(), repr=False)


def score(reads: Sequence[Read], group: str = "all") -> Score:
    """Score frames as one group."""
    whole, torn = [r for r in reads if not r.torn], [r for r in reads if r.torn]
    pairs = [pair for r in whole for pair in _pairs(r)]
    answered = [(found, shown) for found, shown in pairs if found != "?"]
    refused = sum(r.reading.status == "refused" for r in whole)
    torn_refused = sum(r.reading.status == "refused" for r in torn)
    wrong = sum(r.wrong for r in whole)
    torn_wrong = sum(r.wrong for r in torn)
    return Score(
        group,
        digits_right=Share(sum(found == shown for found, shown in answered), len(answered)),
        digits_refused=Share(len(pairs) - len(answered), len(pairs)),
        frames_right=Share(len(whole) - refused - wrong, len(whole) - refused),
        frames_refused=Share(refused, len(whole)),
        torn_right=Share(len(torn) - torn_refused - torn_wrong, len(torn)),
        torn_refused=Share(torn_refused, len(torn)),
        wrong=tuple(r for r in reads if r.wrong),
    )


def by_group(reads: Sequence[Read]) -> tuple[Score, ...]:
    """Score each group in the order of its first frame, and then all together."""
    groups = dict.fromkeys(r.group for r in reads)
    return *(score([r for r in reads if r.group == group], group) for group in groups), score(reads)


def _pairs(read: Read) -> Iterable[tuple[str, str]]:
    """Each digit as it was read and as it is."""
    found = [c for c in read.reading.text if c.isdigit() or c == "?"]
    shown = [c for c in read.text if c.isdigit()]
    return zip(found, shown, strict=True)


def read_dataset(path: str | Path, reader: Reader, *, split: str | None = None) -> tuple[Read, ...]:
    """Read every display of a dataset, all splits or one. The group is the weather.

    Raises
    ------
    DatasetError
        If it is none, or shows no display.
    """
    dataset = datasets.read(path)
    scenario = scenes.load(dataset.path / MANIFEST)
    shown = [row for row in dataset.rows if row.rope_text is not None and split in (None, row.split)]
    if not shown:
        raise DatasetError(f"{path}: no frame shows rope lengths; render with a display.layout")
    own = {frame: one.scenario for one, span in variants(scenario) for frame in span}
    return tuple(_read(dataset, own[row.frame], row, reader) for row in shown)


def _read(dataset: Dataset, own: Scenario, row: Row, reader: Reader) -> Read:
    picture = frame_files.picture(dataset.image(row), row)
    assert own.display_layout is not None
    assert row.rope_text is not None
    reading = reader.read(picture, own.display_layout, display_constant_m=own.display.constant_m)
    below = row.rope_text_below or row.rope_text
    return Read(f"{dataset.path.name}/{row.file}", dataset.weather(row), row.rope_text, below, reading)


def as_json(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """Plain data, with intervals and every wrong frame."""
    result = []
    for one in scores:
        shares = {name: value for name, value in vars(one).items() if isinstance(value, Share)}
        result.append(
            {"group": one.group}
            | {n: {"count": s.count, "of": s.of, "value": s.value, "interval": s.interval} for n, s in shares.items()}
            | {"wrong": [_line(r) for r in one.wrong]}
        )
    return result


def table(scores: Sequence[Score]) -> str:
    """Markdown: a line for each group, and below it the wrong frames of the last."""
    columns = "frames of | digits | right, % | 95 % interval | refused, % | frames | wrong | refused"
    columns += " | torn | either | refused"
    lines = [f"| {columns} |", "|---" * (columns.count("|") + 1) + "|"]
    for s in scores:
        low, high = s.digits_right.interval
        right, whole = s.digits_right.value, s.frames_refused
        lines.append(
            f"| {s.group} | {s.digits_refused.of} | {'' if right is None else f'{100 * right:.4f}'} "
            f"| {100 * low:.4f} … {100 * high:.4f} | {_percent(s.digits_refused)} | {whole.of} "
            f"| {s.frames_right.of - s.frames_right.count} | {whole.count} | {s.torn_right.of} | {s.torn_right.count} "
            f"| {s.torn_refused.count} |"
        )
    wrong = scores[-1].wrong
    lines += ["", f"Frames read wrong: {len(wrong)}."]
    lines += [f"- {r['frame']}: shows {r['shows']}, read {r['read']}" for r in map(_line, wrong[:LARGEST_LIST])]
    return "\n".join(lines)


def _percent(share: Share) -> str:
    return "" if share.value is None else f"{100 * share.value:.4f}"


def _line(read: Read) -> dict[str, str]:
    shows = f"{read.text} over {read.below}" if read.torn else read.text
    return {"frame": read.frame, "group": read.group, "shows": shows, "read": read.reading.text}
