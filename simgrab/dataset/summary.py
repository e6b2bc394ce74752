"""Summary of a finished dataset."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from simgrab.model.scenario import CLAMPABLE, Scenario
from simgrab.model.truth import SPLITS, Row

MANY_CLAMPED = 0.25
"""Share of frames from which on clamping changes a distribution visibly."""


class TallyColumns(msgspec.Struct, frozen=True):
    """The columns of labels that a `Tally` needs."""

    split: str
    alpha_deg: float
    beta_deg: float
    rope_length_m: float
    clamped: str
    visible_fraction: float


class Tally(msgspec.Struct, frozen=True):
    """Sums over frames; two of them can be added."""

    splits: tuple[int, int, int] = (0, 0, 0)  # frames in train, val and test
    # labelled, below_least: frames with a detection label, and those that show too little of the grab for one
    labelled: int = 0
    below_least: int = 0
    alpha_squares: float = 0.0  # sum of α², deg²
    alpha_max: float = 0.0
    beta_min: float = math.inf
    beta_max: float = -math.inf
    shortest_m: float = math.inf
    longest_m: float = -math.inf
    # frames in which each of `simgrab.model.scenario.CLAMPABLE` was replaced by the nearest possible value
    clamped: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, rows: Iterable[Row | TallyColumns], scenario: Scenario) -> Tally:
        """Count frames."""
        rows = list(rows)
        least = least_visible(scenario.labels.least_visible_fraction)
        names = [row.split for row in rows]
        ropes, betas = [row.rope_length_m for row in rows], [row.beta_deg for row in rows]
        return cls(
            splits=(names.count(SPLITS[0]), names.count(SPLITS[1]), names.count(SPLITS[2])),
            labelled=sum(row.visible_fraction >= least for row in rows),
            below_least=sum(0 < row.visible_fraction < least for row in rows),
            alpha_squares=math.fsum(row.alpha_deg**2 for row in rows),
            alpha_max=max((row.alpha_deg for row in rows), default=0.0),
            beta_min=min(betas, default=math.inf),
            beta_max=max(betas, default=-math.inf),
            shortest_m=min(ropes, default=math.inf),
            longest_m=max(ropes, default=-math.inf),
            clamped=clamped(row.clamped for row in rows),
        )

    @property
    def full(self) -> list[str]:
        """Splits that have frames."""
        return [split for split, count in zip(SPLITS, self.splits, strict=True) if count]

    def __add__(self, other: Tally) -> Tally:
        train, val, test = (a + b for a, b in zip(self.splits, other.splits, strict=True))
        return Tally(
            splits=(train, val, test),
            labelled=self.labelled + other.labelled,
            below_least=self.below_least + other.below_least,
            alpha_squares=self.alpha_squares + other.alpha_squares,
            alpha_max=max(self.alpha_max, other.alpha_max),
            beta_min=min(self.beta_min, other.beta_min),
            beta_max=max(self.beta_max, other.beta_max),
            shortest_m=min(self.shortest_m, other.shortest_m),
            longest_m=max(self.longest_m, other.longest_m),
            clamped=(self.clamped[0] + other.clamped[0], self.clamped[1] + other.clamped[1]),
        )

    def stated(self, scenario: Scenario) -> dict[str, dict[str, int]]:
        """Return the manifest's counts of clamped frames, by key, if the scenario allows clamping."""
        counts = dict(zip(CLAMPABLE, self.clamped, strict=True))
        keys = scenario.swing.clamped
        return {"clamped": {key: counts[key] for key in keys}} if keys else {}


def least_visible(stated: float) -> float:
    """Visible fraction from which a frame has a detection label: as stated, but a grab that is not seen has none."""
    return max(stated, 1e-12)


def clamped(columns: Iterable[str]) -> tuple[int, int]:
    """Count frames in which each of `CLAMPABLE` was replaced, from the column ``clamped`` of their labels."""
    keys = [column.split("+") for column in columns]
    jaws, shortened = (sum(key in some for some in keys) for key in CLAMPABLE)
    return jaws, shortened


@dataclass(frozen=True)
class VideoSummary:
    """What finished videos hold.

    Attributes
    ----------
    path : Path
    clips, made : int
        Clips, and those made in this run; the others were there already.
    frames, sent, repeated, dropped : int
        Frames that the camera took, pictures in the videos, pictures that were repeated, and frames that were lost.
    mbit_s : float
        Size of the videos divided by their duration.
    clamped : dict of str to int, or None
        Frames in the videos by key of the swing that was replaced by the nearest possible value; None without
        ``swing.clamp``.
    fingerprint : str
    """

    path: Path
    clips: int
    made: int
    frames: int
    sent: int
    repeated: int
    dropped: int
    mbit_s: float
    clamped: dict[str, int] | None
    fingerprint: str


@dataclass(frozen=True)
class Summary:
    """What a finished dataset holds.

    Attributes
    ----------
    path : Path or str
        Its folder or URL.
    frames, labelled, below_least : int
        Frames, those with a detection label, and those that show too little of the grab for one.
    splits : dict of str to int
    made : int
        Frames rendered in this run; the others were there already.
    alpha_rms_deg, alpha_max_deg : float
        √mean α², and the largest α.
    beta_deg : tuple of 2 floats
        Least and largest tilt of the frames.
    rope_length_m : tuple of 2 floats
        Shortest and longest.
    clamped : dict of str to int, or None
        Frames by key of the swing that was replaced by the nearest possible value; None without ``swing.clamp``.
    fingerprint : str
    video : VideoSummary or None
        Where there is one beside the dataset.
    """

    path: Path | str
    frames: int
    labelled: int
    below_least: int
    splits: dict[str, int]
    made: int
    alpha_rms_deg: float
    alpha_max_deg: float
    beta_deg: tuple[float, float]
    rope_length_m: tuple[float, float]
    clamped: dict[str, int] | None
    fingerprint: str
    video: VideoSummary | None = None

    @classmethod
    def of(cls, path: Path | str, tally: Tally, scenario: Scenario, made: int, fingerprint: str) -> Summary:
        """Sum up a dataset of at least one frame."""
        frames = sum(tally.splits)
        return cls(
            path=path,
            frames=frames,
            labelled=tally.labelled,
            below_least=tally.below_least,
            splits=dict(zip(SPLITS, tally.splits, strict=True)),
            made=made,
            alpha_rms_deg=math.sqrt(tally.alpha_squares / frames),
            alpha_max_deg=tally.alpha_max,
            beta_deg=(tally.beta_min, tally.beta_max),
            rope_length_m=(tally.shortest_m, tally.longest_m),
            clamped=tally.stated(scenario).get("clamped"),
            fingerprint=fingerprint,
        )


def background(summary: Summary) -> list[str]:
    """Count the frames that trainers take for background although they show some of the grab."""
    return [
        "frames that show less of the grab than labels.least_visible_fraction, and have no label: "
        f"{summary.below_least}; other trainers than simgrab's take them for background, unless "
        "simgrab export --leave-out-hidden leaves them out"
    ] * bool(summary.below_least)


def doubts(summary: Summary | VideoSummary) -> list[str]:
    """Name visible grabs without a label, and keys of the swing clamped in more than `MANY_CLAMPED` of the frames."""
    return (background(summary) if isinstance(summary, Summary) else []) + [
        f"swing.{key}: {count} of {summary.frames} draws were impossible and were clamped, so they pile up at "
        "the ends of what is possible: state a range that fits, or change the place or the grab"
        for key, count in (summary.clamped or {}).items()
        if count > MANY_CLAMPED * summary.frames
    ]
