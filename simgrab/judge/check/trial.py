"""Test one instrument on one dataset: its metrics, and the limits that a constant answer would meet."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from simgrab.dataset.datasets import Dataset
from simgrab.instrument.alarm import events
from simgrab.instrument.contract import Frame, Instrument
from simgrab.instrument.detect.pictures import centre
from simgrab.instrument.run.run import measure
from simgrab.instrument.run.runs import Run
from simgrab.instrument.run.subject import one_line
from simgrab.instrument.source import open_source
from simgrab.judge.check.metrics import TIME
from simgrab.judge.check.suite import Limit
from simgrab.judge.evaluate import swings, truths
from simgrab.judge.evaluate.evaluation import cases, evaluate
from simgrab.judge.evaluate.truths import Truths
from simgrab.judge.evaluate.values import Evaluation
from simgrab.model import calibration
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array

_ANSWERS = 101  # between the least and the largest true angle: the best is hardly better than the best of these
Metrics = Mapping[str, float | None]


class Centre(NamedTuple):
    """Centre that was output for a labelled frame, and its distance from the true one.

    ``counted`` is whether figures on centres count it: its box, if any, is a true positive.
    """

    frame: int
    off_px: float
    counted: bool


@dataclass(frozen=True)
class Trial:
    """What an instrument measured of one scene.

    Attributes
    ----------
    dataset : Dataset
    metrics : mapping of str to float or None
        Metrics by dotted name; None if there was nothing to count.
    run, known, evaluation : Run, Truths and Evaluation
        What was measured, the truth of its frames, and both compared.
    """

    dataset: Dataset
    metrics: Metrics
    run: Run
    known: Truths
    evaluation: Evaluation

    @cached_property
    def centres(self) -> list[Centre]:
        """Centres, or centres of boxes, of the labelled frames."""
        return [
            Centre(c.truth.frame, float(np.linalg.norm(centre(c.detection) - labels.centre(c.truth))), c.hits)
            for c in cases(self.run, self.known)
            if c.labelled and c.detection.found and c.truth.grab_u_px is not None
        ]


class TimeLimit(SystemExit):
    """An instrument took too long; not an `Exception`, which it might catch for a single frame."""


def trial(dataset: Dataset, instrument: Instrument, timeout_s: float | None = None) -> Trial:
    """Let an instrument measure a dataset, for so long at most, and evaluate.

    Returns
    -------
    Trial
        Its metrics are the numbers of `simgrab.judge.evaluate.evaluation.evaluate`, and the time that it took, apart
        from that of reading the frames.

    Raises
    ------
    InstrumentError
        If the instrument fails, or breaks the contract.
    """
    camera = calibration.load(dataset.path / "camera.toml")
    source = open_source(dataset.path)
    frames = _Timed(source)
    with one_line(instrument.name), _at_most(timeout_s):
        run = measure(frames, camera, instrument, source=source.name)
    with one_line(f"{instrument.name}: cannot be evaluated"):
        known = truths.of(run, dataset.path)
        found = evaluate(run, known)
    speed = run.about["speed"]
    metrics = flat(found.to_dict()) | {TIME: (speed["seconds"] - frames.seconds) / speed["frames"]}
    return Trial(dataset, metrics, run, known, found)


@contextmanager
def _at_most(seconds: float | None) -> Iterator[None]:
    """Raise `TimeLimit` in the main thread after so many seconds, and each second from then on in case it is caught."""
    if seconds is None:
        yield
        return

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TimeLimit(f"no end in {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class _Timed:
    """Frames, and the time, s, for which reading and decoding them stops the instrument.

    One that reads ahead in a thread of its own works meanwhile: then nothing counts.
    """

    def __init__(self, frames: Iterable[Frame]) -> None:
        self.seconds = 0.0
        self._frames, self._thread = frames, threading.current_thread()

    def __iter__(self) -> Iterator[Frame]:
        waits = threading.current_thread() is self._thread
        begun = time.perf_counter()
        for frame in self._frames:
            self.seconds += waits * (time.perf_counter() - begun)
            yield frame
            begun = time.perf_counter()
        self.seconds += waits * (time.perf_counter() - begun)


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, float | None]:
    """Name the numbers in nested tables by dotted keys; other values are left out.

    Examples
    --------
    >>> flat({"angle": {"rmse_deg": 0.2, "interval": (0.1, 0.3), "worst": None}})
    {'angle.rmse_deg': 0.2, 'angle.worst': None}
    """
    result: dict[str, float | None] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            result |= flat(value, f"{prefix}{key}.")
        elif value is None:
            result[f"{prefix}{key}"] = None
        elif isinstance(value, bool | int | float):
            result[f"{prefix}{key}"] = float(value) if math.isfinite(value) else None
    return result


def constant_alarms(known: Truths, time: Array | None) -> dict[str, Metrics]:
    """Return the alarms' metrics of an instrument that never raises one, and of one that always does.

    They are as of an angle of 0° and of 90° in every frame at times (n,), s; without times there are none.
    """
    if time is None:
        return {}
    found: dict[str, Metrics] = {}
    for how, alpha in (("never", 0.0), ("always", math.pi / 2)):
        answers = swings.by_angles(np.full(len(time), alpha))
        found[how] = flat({"alarm": swings.alarms(time, answers, events(time, answers), known.alpha)})
    return found


def naive(
    known: Truths, limits: Mapping[str, Limit], time: Array | None = None
) -> dict[str, tuple[float | None, float | None]]:
    """Return what instruments without any picture would reach of the metrics of angle and alarms that have limits.

    ``time`` (n,), s, is that of the frames, without which there are no alarms.

    Returns
    -------
    dict of str to tuple of 2 floats or None
        The metric of the constant answer that is best for its limit, and of one that answers the true swing of the
        frame before. The latter is None for frames that do not follow each other in time, and of alarms.
    """
    true = known.alpha
    of_alarms = {name: limit for name, limit in limits.items() if name.startswith("alarm.")}
    limits = {name: limit for name, limit in limits.items() if name.startswith("angle.") and name.endswith("_deg")}
    found: dict[str, tuple[float | None, float | None]] = {}
    answers = constant_alarms(known, time).values() if of_alarms else ()
    for name, limit in of_alarms.items():
        found[name] = (_best([answer.get(name) for answer in answers], limit), None)
    if not limits or not np.isfinite(true).any():
        return found

    def metrics(answer: Array) -> Metrics:
        return flat({"angle": swings.angles(answer, true, known.rope_length, known.weather)})

    constant = [metrics(np.full(len(true), a)) for a in np.linspace(np.nanmin(true), np.nanmax(true), _ANSWERS)]
    clip = np.array([np.nan if row is None or row.clip is None else row.clip for row in known.rows], float)
    last = metrics(np.where(np.diff(clip, prepend=np.nan) == 0, np.append(np.nan, true[:-1]), np.nan))
    for name, limit in limits.items():
        found[name] = (_best([answer.get(name) for answer in constant], limit), last.get(name))
    return found


def _best(values: Iterable[float | None], limit: Limit) -> float | None:
    """Return the value that is best for a limit."""
    return min((value for value in values if value is not None), key=limit.excess, default=None)
