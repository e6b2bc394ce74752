"""Check a suite, and record its baseline: the work of `simgrab check`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from simgrab.dataset.datasets import Dataset
from simgrab.errors import InstrumentError, SuiteError
from simgrab.instrument.contract import Instrument
from simgrab.instrument.run.subject import checked, open_instrument
from simgrab.io.destination import check_folder, writing
from simgrab.io.files import write
from simgrab.judge.check import baseline as base
from simgrab.judge.check import cache, golden
from simgrab.judge.check.baseline import Baseline
from simgrab.judge.check.report import Outcome, Report
from simgrab.judge.check.suite import Limit, Suite, load
from simgrab.judge.check.trial import Trial, constant_alarms, trial
from simgrab.judge.check.verdicts import Verdict, lax, leaves_out, of_trial, surpasses
from simgrab.judge.evaluate.swings import HARDLY_SWINGS_DEG
from simgrab.text import printable

Progress = Callable[[str, int, int], None]
TESTING = ("angle.", "interval.", "detection.", "reading.")  # limits on frames and alarms alone are met by a constant
LEAST_HOIST_M = 0.2  # between the shortest and the longest rope
_BESIDE_ALARMS = {
    "never": "limit alarm.missed in a scene whose swing exceeds 10.5°",
    "always": "limit alarm.precision as well",
}
FEW_SEEDS = 5  # below which the baseline hardly tests other frames


@dataclass(frozen=True)
class CheckOptions:
    """Options of a check.

    Attributes
    ----------
    instrument : Instrument, str or None
        Instrument in place of the suite's, or the name of its factory. It is compared only with a baseline that is
        given too.
    baseline : Path or None
        Folder in place of the suite's.
    seed : int or None
        Seed in place of the suite's. Golden frames are then not compared.
    cache : Path
        Folder of rendered datasets.
    workers : int
        Worker processes.
    cluster : str or None
        Address of a Ray cluster that renders in their place.
    timeout_s : float or None
        Longest time that the instrument may take for a scene; then the check must run in the main thread.
    progress : callable or None
        Called with (name of the scene, frames done, frames in all).
    """

    instrument: Instrument | str | None = None
    baseline: Path | None = None
    seed: int | None = None
    cache: Path = field(default_factory=cache.default)
    workers: int = 1
    cluster: str | None = None
    timeout_s: float | None = None
    progress: Progress | None = None


def check(suite: Suite | str | Path, options: CheckOptions | None = None) -> Report:
    """Let an instrument measure a suite's scenes, and judge the results.

    The check fails, with one line, if the instrument cannot be made, raises an error or breaks the contract.

    Parameters
    ----------
    suite : Suite, str or path
        A suite, or what `simgrab.judge.check.suite.load` takes.
    options : CheckOptions, optional

    Returns
    -------
    Report

    Raises
    ------
    SuiteError
        If the suite or its baseline is invalid.
    ScenarioError, DatasetError, RendererError
        If the suite's frames cannot be made.
    """
    options, suite = options or CheckOptions(), suite if isinstance(suite, Suite) else load(suite)
    seed = suite.seed if options.seed is None else options.seed
    if isinstance(instrument := _instrument(suite, options, seed), Report):
        return instrument
    folder = options.baseline or Path(suite.baseline)
    recorded, general, notes = _compared(suite, instrument.name, folder, options)
    if shares := suite.shares_of_counts():
        notes += (f"warning: limits between 0 and 1 on counts, which are no shares: {', '.join(shares)}",)
    scenes = {name: _scene(suite, name, seed, instrument, recorded, folder, options) for name in suite.scenes}
    labels = {name: scene.trial.dataset.data.labels_sha256 for name, scene in scenes.items() if scene.trial}
    if recorded and any(digest not in recorded.scenes[name].labels for name, digest in labels.items()):
        notes += _of_other_frames(len(recorded.seeds), suite, others=True)
    return Report(suite.name, instrument.name, seed, general, notes + _of_alarms(scenes), scenes)


def record(suite: Suite, options: CheckOptions | None = None, seeds: int | None = None) -> Report:
    """Measure a suite over several seeds and write the baseline: metrics, and golden frames of the first seed.

    Parameters
    ----------
    suite : Suite
    options : CheckOptions, optional
        ``seed`` may not be set.
    seeds : int, optional
        Number of seeds, from the suite's own on; by default the suite's ``seeds``.

    Returns
    -------
    Report
        Report of the suite's own seed, judged by limits alone. Nothing is recorded if the instrument failed under any
        seed, or misses a limit under the suite's own.

    Raises
    ------
    SuiteError, ScenarioError, DatasetError, RendererError
        As for `check`, and if the baseline belongs to another instrument.
    """
    options = options or CheckOptions()
    folder = options.baseline or Path(suite.baseline)
    if _foreign(suite, options):
        raise SuiteError(f"{folder} is the baseline of {suite.instrument}; name another by --baseline")
    check_folder(folder, SuiteError, "--baseline")
    if isinstance(instrument := _instrument(suite, options, suite.seed), Report):
        return instrument
    several = tuple(range(suite.seed, suite.seed + (seeds or suite.seeds)))
    scenes: dict[str, Outcome] = {}
    trials: dict[str, list[Trial]] = {name: [] for name in suite.scenes}
    for seed in several:  # the suite's own in every scene first: only that must meet the limits
        for name, found in trials.items():
            begun = time.perf_counter()
            try:
                found.append(trial(_dataset(suite, name, seed, options), instrument, options.timeout_s))
            except InstrumentError as problem:
                nothing = ("nothing was recorded",)
                return Report(suite.name, instrument.name, seed, _failure(problem, name), nothing, scenes)
            one = judged(name, found[-1], suite.limits_of(name))
            beyond = [f"{v.what} {v.limit}" for v in one.verdicts if v.status == "failed"]
            first, notes = scenes.get(name, one), list[str]()
            if beyond and seed != suite.seed:
                notes.append(f"{name}: warning: not met with seed {seed}: {', '.join(beyond)}")
            seconds = first.seconds + time.perf_counter() - begun
            scenes[name] = replace(first, seconds=seconds, notes=(*first.notes, *notes))
        if any(v.status == "failed" for scene in scenes.values() for v in scene.verdicts):
            nothing = ("nothing was recorded, because limits are not met: mend the cause, or change the limits",)
            return Report(suite.name, instrument.name, suite.seed, (), nothing, scenes)
    _write(folder, base.compose(suite, instrument.name, several, trials), suite, trials)
    done: tuple[str, ...] = (f"recorded over {len(several)} seed{'s' * (len(several) > 1)} in {printable(folder)}",)
    done += _of_other_frames(len(several), suite)
    if len(several) > 1:
        ranges = {name: _ranges(suite.limits_of(name), each) for name, each in trials.items()}
        done += tuple(f"{name}: over these seeds: {text}" for name, text in ranges.items() if text)
    return Report(suite.name, instrument.name, suite.seed, (), done + _of_alarms(scenes), scenes)


def _of_alarms(scenes: Mapping[str, Outcome]) -> tuple[str, ...]:
    """Warn if an instrument that never raises an alarm, or always does, would meet all limits on alarms."""
    limited = {
        name: {what: limit for what, limit in scene.limits.items() if what.startswith("alarm.")}
        for name, scene in scenes.items()
    }
    answers = {
        name: constant_alarms(scene.trial.known, scene.trial.run.time)
        for name, scene in scenes.items()
        if scene.trial is not None and limited[name]
    }
    for how, more in _BESIDE_ALARMS.items():
        values = [
            (f"{name} {what} {limit}", limit, answers.get(name, {}).get(how, {}).get(what))
            for name, limits in limited.items()
            for what, limit in limits.items()
        ]
        if values and all(value is not None and limit.holds(value) for _, limit, value in values):
            met = ", ".join(f"{text} ({value:.4g})" for text, _, value in values)
            how = f"an instrument that {how} raises an alarm"
            return (f"warning: limits on alarms are too loose, since {how} would pass: {met}; {more}",)
    return ()


def _ranges(metrics: Iterable[str], trials: Sequence[Trial]) -> str:
    """State between which values metrics lie."""
    known = {name: [v for one in trials if (v := one.metrics.get(name)) is not None] for name in metrics}
    return ", ".join(f"{name} {min(values):.4g} to {max(values):.4g}" for name, values in known.items() if values)


def _of_other_frames(seeds: int, suite: Suite, *, others: bool = False) -> tuple[str, ...]:
    """State what a baseline of so many seeds allows on other frames, if these are some or it is much."""
    few = seeds < FEW_SEEDS
    if seeds == 1 or not (few or others):
        return ()
    allowed = base.deviations(seeds, base.ends(suite))
    which = "other frames than those recorded, as here," if others else "other frames"
    text = f"on {which} a figure may be worse than its mean by {allowed:.0f} standard deviations"
    why = f", because the baseline has only {seeds} seeds: record more --seeds"
    return (f"warning: {text}{why}" if few else f"{text} over the baseline's seeds",)


def _instrument(suite: Suite, options: CheckOptions, seed: int) -> Instrument | Report:
    """Make the instrument, or report why it cannot be made; refuse an impossible scene before the first is rendered."""
    check_folder(options.cache, SuiteError, "--cache")
    chosen = suite.instrument if options.instrument is None else options.instrument
    try:
        instrument = open_instrument(chosen) if isinstance(chosen, str) else checked(chosen)
    except InstrumentError as problem:
        return Report(suite.name, printable(str(chosen)), seed, _failure(problem))
    for name in list(suite.scenes)[1:]:
        cache.check_possible(suite.scenario(name, seed), options.cache)
    return instrument


def _foreign(suite: Suite, options: CheckOptions) -> bool:
    """Whether the baseline belongs to another instrument."""
    return options.instrument not in (None, suite.instrument) and options.baseline is None


def _failure(problem: InstrumentError, scene: str = "") -> tuple[Verdict, ...]:
    return (Verdict(scene=scene, what="instrument", status="failed", message=str(problem)),)


def _compared(
    suite: Suite, instrument: str, folder: Path, options: CheckOptions
) -> tuple[Baseline | None, tuple[Verdict, ...], tuple[str, ...]]:
    """Find the baseline to compare with; reasons against it, and a note where there is none."""
    recorded = base.load(folder)
    if recorded is None and options.baseline is not None:
        raise SuiteError(f"{folder}: no baseline is recorded there; record one by --update-baseline")
    if recorded is None or _foreign(suite, options):
        where = printable(folder)
        why = f"none is recorded in {where}" if recorded is None else f"that in {where} is of {recorded.instrument}"
        return None, (), (f"no baseline to compare with ({why}): limits only",)
    reasons = base.stale(recorded, suite, instrument)
    if not reasons:
        return recorded, (Verdict(scene="", what="baseline", status="passed"),), ()
    message = f"out of date: {'; '.join(reasons)}. Find the cause, then run with --update-baseline"
    return None, (Verdict(scene="", what="baseline", status="failed", message=message),), ()


def _scene(
    suite: Suite, name: str, seed: int, instrument: Instrument, recorded: Baseline | None, folder: Path,
    options: CheckOptions,
) -> Outcome:  # fmt: skip
    begun, limits, frames = time.perf_counter(), suite.limits_of(name), suite.scenes[name].golden
    dataset = _dataset(suite, name, seed, options)
    try:
        found = judged(name, trial(dataset, instrument, options.timeout_s), limits, recorded, base.ends(suite))
    except InstrumentError as problem:
        found = Outcome(_failure(problem, name), {}, 0.0)
    verdicts, notes, pictures = list(found.verdicts), list[str](), {}
    if blind := [v.what for v in verdicts if recorded and v.value is not None and v.reference is None]:
        why = "because the baseline has too few values"
        notes.append(f"{name}: compared with limits only, {why}: {', '.join(blind)}")
    notes += found.notes
    if not (limits or frames):
        notes.append(f"{name}: nothing is judged, because it has no limits")
    for frame in frames if seed == suite.seed else ():
        verdict, difference = golden.look(name, frame, dataset, folder, suite.least_ssim)
        verdicts.append(verdict)
        if difference is not None:
            pictures[f"{name}-{frame:06d}.png"] = difference
    seconds = time.perf_counter() - begun
    return replace(found, verdicts=tuple(verdicts), seconds=seconds, pictures=pictures, notes=tuple(notes))


def judged(
    name: str, found: Trial, limits: Mapping[str, Limit], recorded: Baseline | None = None, comparisons: int = 1
) -> Outcome:
    """Judge a trial of a scene, and warn of centres that figures leave out, and of limits that a constant angle meets.

    Parameters are those of `simgrab.judge.check.verdicts.of_trial`.
    """
    verdicts, notes = tuple(of_trial(name, found, limits, recorded, comparisons)), []
    if left := leaves_out(found, verdicts):
        notes.append(f"{name}: warning: {left}")
    if found.metrics.get("alarm.sure") == 0 and any(v.what == "alarm.missed" for v in verdicts):
        notes.append(f"{name}: warning: alarm.missed tests nothing, since no swing exceeds 10.5°")
    without = found.metrics.get("frames.without_grab")
    if without and "frames.without_grab" not in limits:
        notes.append(
            f"{name}: warning: {without:.0f} of {found.metrics['frames.ok']:.0f} angles are of frames without a grab; "
            "set a limit on frames.without_grab"
        )
    of_measurement = [v for v in verdicts if v.status == "passed" and v.what.startswith(TESTING)]  # not of time
    better = [v for v in of_measurement if surpasses(v, limits[v.what])]
    if listed := ", ".join(f"{v.what} {v.value:.4g} (baseline: {v.reference:.4g})" for v in better):
        notes.append(
            f"{name}: warning: better than the baseline by more than chance or slack: {listed}; a fault, as of lens "
            "or offset, may offset an error that was there; where the change is meant, --update-baseline records it"
        )
    rope, swing = found.known.rope_length, found.known.alpha[np.isfinite(found.known.alpha)]
    if np.nanmax(rope) - np.nanmin(rope) < LEAST_HOIST_M and any(v.what.startswith("reading.length") for v in verdicts):
        notes.append(f"{name}: warning: limits on reading.length test little, since the rope's length hardly changes")
    of_angles = any(v.constant is not None and v.what.startswith("angle.") for v in verdicts)
    if len(swing) > 1 and np.degrees(swing.std()) < HARDLY_SWINGS_DEG and of_angles:
        spread = f"standard deviation {np.degrees(swing.std()):.2f} deg"
        notes.append(
            f"{name}: warning: the grab hardly swings ({spread}), so that no limit on angles tests anything: take more "
            "frames, or another part of the motion (swing.settle_s, swing.start)"
        )
    elif met := lax(verdicts, limits):
        passed = ", ".join(f"{v.what} {v.limit} (constant: {v.constant:.4g})" for v in met)
        notes.append(f"{name}: warning: too loose, since the same angle in every frame would pass: {passed}")
    elif limits and not any(metric.startswith(TESTING) for metric in limits):
        notes.append(f"{name}: warning: no limit is on angle.*, so that the same angle in every frame may pass")
    return Outcome(verdicts, found.metrics, 0.0, notes=tuple(notes), trial=found, limits=limits)


def _dataset(suite: Suite, name: str, seed: int, options: CheckOptions) -> Dataset:
    scenario, own = suite.scenario(name, seed), suite.scenes[name].seed
    progress = partial(options.progress, f"{name}, seed {seed if own is None else own}") if options.progress else None
    return cache.rendered(scenario, options.cache, workers=options.workers, cluster=options.cluster, progress=progress)


def _write(folder: Path, recorded: Baseline, suite: Suite, trials: dict[str, list[Trial]]) -> None:
    datasets = {name: found[0].dataset for name, found in trials.items()}
    kept, files = golden.keep(datasets, {name: scene.golden for name, scene in suite.scenes.items()})
    files[golden.FILE] = msgspec.json.format(msgspec.json.encode(kept), indent=1) + b"\n"
    files[base.FILE] = msgspec.json.format(msgspec.json.encode(recorded), indent=1) + b"\n"
    with writing(f"the baseline {folder}", SuiteError):
        for file, data in files.items():  # the lists last: they name the pictures
            write(folder / file, data)
