"""Score early warnings of swings beyond 10° on simulated work, without pictures; fit their threshold.

    scripts/python -m scripts.early_warning [--ordinary 240] [--dangerous 30] [--work runs/early-warning]

Clips of five minutes: ordinary working cycles, and work that slews hard. The instrument gets the true direction OA with
1.3 px of noise at 9 frames/s, a tilt that errs by 0.13° per axis, as one from a calm recording does, and a rope length
that lags by 0.5 s. The controller states slew angle in steps of 0.1° and radius in steps of 1 cm, ten times a second,
0.2 s late and with a jitter of 10 ms, and with them the setpoints of its drives. Forecasts are made three times a
second. Thresholds are fitted to the budget on every second ordinary clip, and applied to all others. Trajectories are
kept.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simgrab.instrument import alarm
from simgrab.instrument.contract import Measurement
from simgrab.instrument.controller import Controller
from simgrab.instrument.controller_feed import KEPT_S
from simgrab.instrument.forecast import MIDDLES_S, Forecaster, forecast
from simgrab.judge.evaluate import warnings
from simgrab.judge.evaluate.swings import SURELY, true_events
from simgrab.model import scenes
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import Scenario
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.trajectory import Trajectory
from simgrab.world.trajectory.work import Work

FRAMES, EVERY, FROM = 2700, 3, 45  # of a clip; a forecast every third; the first one
AT_ONCE = 10  # clips in a process
STEPS, LATE_S, JITTER_S = (np.radians(0.1), 0.01), 0.2, 0.01  # of slew angle and radius; age of readings
NOISE, TILT = 1.3 / 1644.82, np.radians(0.13)
HARD = {"swing.work.slew_rpm": 1.2, "swing.work.operator": 0.75, "swing.work.slew_deg": -90.0}  # ramps of 6 s
WORLDS: dict[str, tuple[str, Mapping[str, Any]]] = {
    "calm": ("work-cycles", {}),
    "breeze": ("work-cycles", {"swing.wind.mean_m_s": 10.0, "swing.work.operator": 0.6}),
    "abrupt": ("alarm-cycles", {}),
    "fast": ("work-cycles", HARD),
    "fast16": ("work-cycles", HARD | {"swing.work.carry_rope_m": 16.0}),
}
ORDINARY, DANGEROUS = ("calm", "breeze"), ("abrupt", "fast", "fast16")
SETPOINTS = "slew_setpoint", "radius_setpoint"
GIVEN = {"forecast": None, "forecast, with the controller": (), "forecast, with its setpoints": SETPOINTS}
BUDGET_PER_H = 1.0
THRESHOLDS = np.round(np.arange(0.3, 1.0, 0.05), 2)
Clip = dict[str, Any]


def _scenario(name: str, clip: int) -> Scenario:
    scene, changes = WORLDS[name]
    return scenes.load(scene, {"frames": FRAMES, "seed": 1000 + clip, **changes})


def simulate(folder: Path, job: tuple[str, int]) -> None:
    """Simulate one clip, unless it is there."""
    name, clip = job
    path = folder / f"{name}-{clip}.npz"
    if path.exists():
        return
    trajectory = Trajectory(_scenario(name, clip))
    moments = [trajectory.at(i) for i in range(FRAMES)]
    columns = {
        "time": [m.time for m in moments], "alpha": [m.grab.alpha for m in moments],
        "azimuth": [m.grab.azimuth for m in moments], "rope": [m.grab.rope_length for m in moments],
        "jib": [(m.jib.slew, m.jib.radius) for m in moments if m.jib],
    }  # fmt: skip
    draft = path.with_suffix(".part.npz")
    np.savez(draft, **columns)  # type: ignore[arg-type]
    draft.rename(path)


def read(folder: Path, name: str, clip: int) -> Clip:
    """Read a clip, and add what an instrument sees of it."""
    found: Clip = dict(np.load(folder / f"{name}-{clip}.npz")) | {"world": name}
    rng, time = stream(3, clip, name), found["time"]
    way = np.stack([np.cos(found["azimuth"]), np.sin(found["azimuth"])], axis=-1)
    found["swing"] = np.sin(found["alpha"])[:, None] * way + rng.normal(0, TILT, 2) + rng.normal(0, NOISE, way.shape)
    found["seen"] = np.arcsin(np.hypot(*found["swing"].T))
    found["length"] = np.interp(time - 0.5, time, found["rope"]).round(2)
    at = np.arange(0.0, time[-1], 0.1)
    stamps = at + rng.normal(0, JITTER_S, len(at)).clip(-0.045, 0.045)
    slew, radius = (CubicSpline(time, found["jib"])(at) / STEPS).round().T * np.array(STEPS)[:, None]
    fast = np.quantile(np.abs(np.diff([slew, radius])), 0.98, axis=1) / 0.1
    sds = np.hypot(np.array(STEPS) / np.sqrt(12), JITTER_S * fast)
    scenario = _scenario(name, clip)
    work = Work(scenario, 0)
    moments = at + ClipMotion(scenario, 0).warm_up_s
    work.sample(moments)
    slew_setpoint, radius_setpoint = work.setpoints(moments)
    found["controller"] = Controller(
        stamps, slew, radius, slew_sd=float(sds[0]), radius_sd=float(sds[1]), slew_setpoint=slew_setpoint,
        radius_setpoint=radius_setpoint,
    )  # fmt: skip
    begins, ends = (np.searchsorted(at, time - late, side="right") for late in (KEPT_S, LATE_S))
    found["spans"] = list(map(slice, begins.tolist(), ends.tolist()))
    return found


def motion(clip: Clip, frame: int, columns: Sequence[str]) -> tuple[Array, Array]:
    """Return the jib's motion as the controller shows it in a frame by some of its columns."""
    whole, some = clip["controller"], clip["spans"][frame]
    latest = {name: getattr(whole, name)[some] if name in columns else None for name in SETPOINTS}
    known = {name: getattr(whole, name)[some] for name in ("time", "slew", "radius")}
    return replace(whole, **known, **latest).jib_motion(clip["time"][frame], MIDDLES_S)


def forecasts(folder: Path, batch: tuple[list[tuple[str, int]], Sequence[str] | None]) -> list[dict[str, Array]]:
    """Forecast in some clips at once, as a live run does, with no data of the controller, or with some setpoints."""
    jobs, setpoints = batch
    clips, found = [read(folder, *job) for job in jobs], []
    together = {key: np.stack([clip[key] for clip in clips]) for key in ("swing", "length")}
    forecaster = Forecaster(len(clips))
    for i, time in enumerate(clips[0]["time"]):
        reported = [] if setpoints is None else zip(*(motion(clip, i, setpoints) for clip in clips), strict=True)
        columns = map(np.stack, reported)
        state = forecaster.step(time, together["swing"][:, i], NOISE, together["length"][:, i], *columns)
        if i >= FROM and i % EVERY == 0:
            found.append(vars(forecast(state, np.full(len(clips), TILT))))
    return [{key: np.array([f[key][k] for f in found]) for key in found[0]} for k in range(len(clips))]


def measured(clip: Clip, ahead: Mapping[str, Array]) -> list[Measurement]:
    """Make measurements with forecasts, of every third frame."""
    some = slice(FROM, None, EVERY)
    keys, columns = list(ahead), zip(clip["seen"][some], clip["length"][some], *ahead.values(), strict=True)
    return [
        Measurement(status="ok", alpha=a, rope_length_m=rope, **dict(zip(keys, values, strict=True)))
        for a, rope, *values in columns
    ]


def guessed(peak: Array, sd: float) -> dict[str, Array]:
    """Make forecasts of peaks (n,) that a simple rule names, with their standard deviation."""
    peak = peak[FROM::EVERY]
    chance = alarm.exceeding(peak, np.full(len(peak), sd), alarm.DANGER)
    return {"warning": np.nan_to_num(chance), "peak": np.nan_to_num(peak)}


PRESENT = "present rule"
SIMPLE: dict[str, tuple[Callable[[Clip], Array], float]] = {
    "last amplitude persists": (lambda c: warnings.last_peak(c["seen"]), np.radians(1.0)),
    "pendulum from two frames": (
        lambda c: warnings.from_two_frames(c["time"], c["seen"], c["length"]),
        np.radians(1.0),
    ),
    PRESENT: (lambda c: c["seen"], TILT),
}


def pooled(clips: list[Clip], measurements: list[list[Measurement]], threshold: float) -> dict[str, Any]:
    """Score clips together at a threshold."""
    some = slice(FROM, None, EVERY)
    each = [
        warnings.score(c["time"][some], m, c["alpha"][some], threshold)
        for c, m in zip(clips, measurements, strict=True)
    ]
    found = {key: sum(s[key] for s in each) for key in ("hours", "events", "missed", "late", "reported", "false")}
    chance = np.array([m.warning for one in measurements for m in one])
    most = np.concatenate([warnings.within(c["time"][some], c["alpha"][some]) for c in clips])
    stated, happened = warnings.unsure(chance, most)
    leads = [lead for s in each for lead in s["leads"]]
    return found | {
        "lead_s": float(np.median(leads)) if leads else float("nan"), "per_h": found["false"] / found["hours"],
        "reliability": warnings.reliability(stated, happened), "unsure": len(stated),
        "peak": float(np.sqrt(np.nanmean([s["peak_rmse_deg"] ** 2 for s in each]))),
    }  # fmt: skip


def since_ramp(clip: Clip) -> list[float]:
    """Time, s, from the beginning of the last slewing ramp to each event: what no forecast from motion can exceed."""
    time = clip["time"]
    ramp = np.abs(np.gradient(np.gradient(clip["jib"][:, 0], time), time)) > np.radians(0.25)
    starts = time[1:][ramp[1:] & ~ramp[:-1]]
    onsets = [e.onset_s for e in true_events(time, clip["alpha"]) if e.alpha > SURELY]
    return [float(onset - starts[starts < onset][-1]) for onset in onsets if (starts < onset).any()]


@click.command()
@click.option("--ordinary", default=240, show_default=True, help="Clips of ordinary work.")
@click.option("--dangerous", default=30, show_default=True, help="Clips with events, a third by each cause.")
@click.option("--first", default=20, show_default=True, help="Clip of each kind; those before served to set it up.")
@click.option("--work", type=click.Path(path_type=Path), default=Path("runs/early-warning"), show_default=True)
@click.option("--workers", default=2, show_default=True)
def main(ordinary: int, dangerous: int, first: int, work: Path, workers: int) -> None:
    """Print thresholds, leads and false warnings of each method."""
    work.mkdir(parents=True, exist_ok=True)
    jobs = [(name, i) for names, n in ((ORDINARY, ordinary), (DANGEROUS, dangerous)) for name in names
            for i in range(first, first + n // len(names))]  # fmt: skip
    batches = [jobs[i : i + AT_ONCE] for i in range(0, len(jobs), AT_ONCE)]
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        list(pool.map(partial(simulate, work), jobs))
        ways = [pool.map(partial(forecasts, work), [(batch, given) for batch in batches]) for given in GIVEN.values()]
        found_by = [[one for batch in way for one in batch] for way in ways]
    clips = [read(work, *job) for job in jobs]
    ahead = dict(zip(GIVEN, found_by, strict=True))
    ahead |= {name: [guessed(rule(clip), sd) for clip in clips] for name, (rule, sd) in SIMPLE.items()}
    calm = np.array([c["world"] in ORDINARY for c in clips])
    fitted_on = np.flatnonzero(calm)[::2]
    parts = {"ordinary": np.setdiff1d(np.flatnonzero(calm), fitted_on)} | {
        name: np.flatnonzero([c["world"] == name for c in clips]) for name in DANGEROUS
    }
    parts["all dangerous"] = np.flatnonzero(~calm)
    print("| method | threshold | clips | hours | false/h | events | missed | late | lead, s | reliability | peak, ° |")
    print("|---" * 11 + "|")
    for method, forecast_of in ahead.items():
        found = [measured(*both) for both in zip(clips, forecast_of, strict=True)]

        def of(some: NDArray[np.int64], threshold: float, found: list[list[Measurement]] = found) -> dict[str, Any]:
            return pooled([clips[i] for i in some], [found[i] for i in some], threshold)

        allowed = [alarm.RAISED_AT] if method == PRESENT else THRESHOLDS
        threshold = next((t for t in allowed if of(fitted_on, t)["per_h"] <= BUDGET_PER_H), allowed[-1])
        for part, some in parts.items():
            f = of(some, threshold)
            print(
                f"| {method} | {threshold:.2f} | {part} | {f['hours']:.1f} | {f['per_h']:.2f} | {f['events']} "
                f"| {f['missed']} | {f['late']} | {f['lead_s']:.1f} | {100 * (f['reliability'] or 0):.1f} % "
                f"| {f['peak']:.2f} |"
            )
    for name in (*DANGEROUS, "all dangerous"):
        times = [t for i in parts[name] for t in since_ramp(clips[i])]
        print(f"{name}: the last ramp begins {np.median(times):.1f} s before an event (median of {len(times)})")


if __name__ == "__main__":
    main()
