"""Results of an evaluation, as typed values. A part is None if there is nothing to compare."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from msgspec import UNSET, UnsetType


class AngleErrors(msgspec.Struct, frozen=True):
    """Errors of angles, degrees: mean, root mean square, 95 % quantile and largest of the absolute error."""

    frames: int
    bias_deg: float | None
    rmse_deg: float | None
    p95_deg: float | None
    max_deg: float | None


class Angles(msgspec.Struct, frozen=True):
    """Errors of all frames, of swings above 8°, by rope length and by weather."""

    overall: AngleErrors
    above_8_deg: AngleErrors
    by_rope: dict[str, AngleErrors]
    by_weather: dict[str, AngleErrors]


class Coverage(msgspec.Struct, frozen=True):
    """Share of true angles within their intervals, and the intervals' mean width."""

    frames: int
    share: float | None
    width_deg: float | None


class Alarms(msgspec.Struct, frozen=True):
    """Alarms against the events of the true swing; see `simgrab.judge.evaluate.swings.alarms`."""

    events: int
    sure: int
    missed: int
    reported: int
    false: int
    delays: list[int]
    already_on: int
    median_delay: float | None
    precision: float | None
    recall: float | None


class DetectionScore(msgspec.Struct, frozen=True):
    """Boxes and centres; see `simgrab.judge.evaluate.detection.figures`. Boxes' figures are None for centres alone."""

    frames: int
    labelled: int
    empty: int
    map50_95: float | None
    map50: float | None
    recall: float | None
    recall_interval: tuple[float, float] | None
    labelled_worlds: int
    missed_worlds: int | None
    longest_miss: int | None
    false_boxes: int | None
    false_share: float | None
    false_interval: tuple[float, float] | None
    empty_worlds: int
    false_worlds: int | None
    centre: dict[str, Any]
    coverage: dict[str, Any] | None
    jitter_px: float | None


class Share(msgspec.Struct, frozen=True):
    """A count among others, with its 95 % interval."""

    count: int
    of: int
    value: float | None
    interval: tuple[float, float] | None


class Lengths(msgspec.Struct, frozen=True):
    """Absolute errors of the rope's length."""

    frames: int
    median_m: float | None
    p95_m: float | None
    max_m: float | None


class Wrong(msgspec.Struct, frozen=True):
    """A frame read wrong: its name, what the display shows, and what was read."""

    frame: str
    shows: str
    read: str


class ReadingScore(msgspec.Struct, frozen=True):
    """How the displays of frames were read, and errors of the rope's length.

    All shares except ``torn_…`` count frames whose display did not tear.

    Attributes
    ----------
    digits_right, digits_refused : Share
        Right digits among digits that were read; refused digits among all.
    frames_right, frames_refused : Share
        Frames with both numbers right, among frames without a refused digit; frames with one, among all.
    torn_right, torn_refused : Share
        Torn frames whose read numbers each belong to the text above or below; torn frames refused. The rest were read
        as a mixture.
    wrong : list of Wrong
        Every frame read wrong, torn or whole.
    jumps : int
        Readings that the hoist is too slow to have reached.
    length : Lengths
    """

    digits_right: Share
    digits_refused: Share
    frames_right: Share
    frames_refused: Share
    torn_right: Share
    torn_refused: Share
    wrong: list[Wrong]
    jumps: int
    length: Lengths


class Warnings(msgspec.Struct, frozen=True):
    """Early warnings, and forecasts of the next turning point, compared with the true swing.

    Attributes
    ----------
    hours : float
    events, missed, late : int
        True swings beyond 10.5°; those without a warning, and those whose warning did not come before 10° was passed.
    reported, false : int
        Warnings, and those in which, and 6 s after which, the true swing stays below 9.5°.
    false_per_h : float or None
    leads : list of float
        Time from the warning to the true 10°, s, at most 6 s, of each event with one; ``lead_s`` is their median.
    unsure : int
        Frames with a forecast between 5 % and 95 % whose next 6 s are known.
    reliability : float or None
        Mean distance, over these frames, of the share that happened from the stated probability, in ten bins.
    peak_rmse_deg, persist_rmse_deg, two_frames_rmse_deg : float or None
        Errors of the next turning point's swing: as forecast, if the last one persists, and of an undamped pendulum
        from two frames.
    peak_coverage, peak_width_deg : float or None
        Share of turning points within their 95 % intervals, and these intervals' mean width (sharpness).
    """

    hours: float
    events: int
    missed: int
    late: int
    reported: int
    false: int
    false_per_h: float | None
    leads: list[float]
    lead_s: float | None
    unsure: int
    reliability: float | None
    peak_rmse_deg: float | None
    persist_rmse_deg: float | None
    two_frames_rmse_deg: float | None
    peak_coverage: float | None
    peak_width_deg: float | None


class BudgetRow(msgspec.Struct, frozen=True):
    """One row of the error budget: what was replaced by the truth, the tilt that followed, and the errors of α."""

    stage: str
    frames: int
    bias_deg: float | None
    rmse_deg: float | None
    p95_deg: float | None
    max_deg: float | None
    beta_deg: float | UnsetType | None = UNSET


class Budget(msgspec.Struct, frozen=True):
    """The share of each stage in the error of α; see `simgrab.judge.evaluate.budget.budget`."""

    estimator: str
    tilt: str
    chain: list[BudgetRow]
    limit: str
    aside: list[BudgetRow]
    drawn: BudgetRow
    paper: list[BudgetRow]
    run: BudgetRow


class FrameCounts(msgspec.Struct, frozen=True):
    """Number of frames of the run, of frames with known truth, and of frames with each status.

    ``without_grab`` counts the frames with an angle, but without a grab.
    """

    all: int
    known: int
    ok: int
    missed: int
    unread: int
    lost: int
    refused: int
    without_grab: int


class Provenance(msgspec.Struct, frozen=True):
    """Source and instrument, and notes, empty where there is nothing to note.

    They are on how frames were matched by time, on a grab that hardly swings, on angles that seem to be in radians, and
    on where the run's camera file differs from the true camera.
    """

    source: str
    instrument: str
    matched: str = ""
    still: str = ""
    unit: str = ""
    camera: str = ""


class Evaluation(msgspec.Struct, frozen=True):
    """A run compared with the truth. It can be indexed by the names of its parts, which gives plain data.

    Attributes
    ----------
    run : Provenance
    frames : FrameCounts
    detection : DetectionScore or None
    reading : ReadingScore or None
    angle : Angles
    interval : Coverage
    alarm : Alarms or None
        None where frames have no time.
    warning : Warnings or None
        None where there are no forecasts.
    budget : Budget or None
    """

    run: Provenance
    frames: FrameCounts
    detection: DetectionScore | None
    reading: ReadingScore | None
    angle: Angles
    interval: Coverage
    alarm: Alarms | None
    warning: Warnings | None
    budget: Budget | None

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as ``simgrab evaluate --json`` prints it."""
        return dict(msgspec.to_builtins(self))

    def __getitem__(self, part: str) -> Any:
        if part not in self.__struct_fields__:
            raise KeyError(part)
        return msgspec.to_builtins(getattr(self, part))

    def __iter__(self) -> Iterator[str]:
        return iter(self.__struct_fields__)

    def __len__(self) -> int:
        return len(self.__struct_fields__)

    get, keys, values, items = Mapping.get, Mapping.keys, Mapping.values, Mapping.items


Mapping.register(Evaluation)
