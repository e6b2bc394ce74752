"""Print errors of α and their coverage by mount, weather, length of the record and input, without pictures.

    scripts/python -m scripts.estimator_study [--mount levelled] [--weather fog] [--seconds 60] [--input controller] …

The crane works. The estimator gets the true grab centre with the detector's errors in that weather, the rope length in
centimetres, an offset with an error of 5 cm per coordinate, and the mean wind. Each clip of ten minutes is
cut into records; `--share` limits how many of them, evenly spaced, are used.
Coverage has a bootstrap interval over clips.
"""

from __future__ import annotations

import itertools
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import click
import msgspec
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

import simgrab
from simgrab.dataset.tables import calibration_of
from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import Estimator, PendulumSmoother, RopeAware
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.estimate.intervals import WORKING
from simgrab.instrument.estimate.pendulum_smoother import WANDER_S
from simgrab.instrument.estimate.solve import stated_ends
from simgrab.lab.bench.season import WIND_M_S
from simgrab.model import scenes
from simgrab.model.geometry import Array, to_camera
from simgrab.model.rng import stream
from simgrab.model.scenario import Scenario
from simgrab.world.scenery.grabs import design_of
from simgrab.world.sensors.encoders import SLACK
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.moment import Moment, Tilt
from simgrab.world.trajectory.mount import tilted
from simgrab.world.trajectory.trajectory import Trajectory
from simgrab.world.trajectory.work import Work

MOUNTS = ("levelled", "rigid", "fixed")
# Errors of the detector's centre at 960×540, in px at 1920 px across: of each frame, and such as last for seconds, root
# mean squares per coordinate over the clips of that weather in the season `open` of SwingBench.
ERRORS: dict[str, tuple[float, float]] = {
    "calm-day": (0.9, 5.2), "windy-day": (0.8, 3.1), "night-light-snow": (1.1, 4.5), "heavy-snow": (1.0, 3.1),
    "rain": (0.5, 2.5), "fog": (0.8, 4.5), "dust": (0.8, 6.0), "glare": (0.7, 5.4),
}  # fmt: skip
INPUTS = ("rope-aware", "smoother", "controller", "imu", "controller+imu")
CALM_M_S = 4.0  # of the other weathers
CLIP_S, RATE_HZ = 600.0, 9.0
LENGTHS_S = (20.0, 60.0, 300.0, 600.0)
MINUTE_S = 60.0
OFFSET_SD_M, ROPE_STEP_M, CLOCK_SD_S = 0.05, 0.01, 1.0
LOAD_STEP_KG, LOAD_SCALE_SD, GRAB_KG = 100.0, 0.02, 10500.0
RESAMPLES = 1000
Cell = tuple[str, str, float, str]
Reading = dict[str, float]
Errors = list[tuple[float, ...]]  # of records


def _scenario(mount: str, wind: float, clip: int) -> Scenario:
    frames = int(CLIP_S * RATE_HZ)
    return scenes.load("work-cycles", {
        "frames": frames, "clip.clip_frames": frames, "seed": 100 + clip, "camera.mount": {"model": mount},
        "swing.wind": {"mean_m_s": wind}, "sensors.imu0": {"model": "imu", "mount": "camera", "noise": "mems"},
    })  # fmt: skip


@lru_cache(maxsize=1)
def _moments(wind: float, clip: int) -> list[Moment]:
    """Simulate a clip's grab, which no mount of the camera changes."""
    scenario = _scenario("fixed", wind, clip)
    story = Trajectory(scenario)
    return [story.at(frame) for frame in range(scenario.frames)]


@lru_cache(maxsize=1)
def _clip(mount: str, wind: float, clip: int) -> tuple[Any, ...]:
    """Simulate a clip: scenario, calibration, times (n,), jib (n, 2), α (n,), rope (n,), pixels (n, 2), mass (n,)."""
    scenario, moments = _scenario(mount, wind, clip), _moments(wind, clip)
    known = calibration_of(scenario)
    centre = np.array([m.grab.jib_from_grab.translation for m in moments])
    turn = np.array([tilt.jib_from_camera for tilt in _tilts(scenario, len(moments))])
    pixels = known.intrinsics.project(to_camera(centre, turn, np.array(known.offset_m)))
    return (
        scenario, known, np.array([m.time for m in moments]),
        np.array([(m.jib.slew, m.jib.radius) for m in moments if m.jib]), np.array([m.grab.alpha for m in moments]),
        np.array([m.grab.rope_length for m in moments]), pixels,
        _hoisted(scenario, moments),
    )  # fmt: skip


def _hoisted(scenario: Scenario, moments: list[Moment]) -> Array:
    """Return what a load cell reads at moments (n,), kg."""
    grab, work = design_of(scenario.grab), ClipMotion(scenario, 0)
    held = Work(scenario, 0).sample(np.array([m.time for m in moments]) + work.warm_up_s).held
    return np.where(held, SLACK, 1.0) * [grab.mass_of(0.0, m.grab.load).mass for m in moments]


def _tilts(scenario: Scenario, frames: int) -> list[Tilt]:
    """Attitude of the camera in the first frames of clip 0, which takes no physics of the grab."""
    motion, found = ClipMotion(scenario, 0), list[Tilt]()
    every = round(1 / (scenario.clip.frame_rate_hz * motion.interval))
    for block in motion.blocks(Work(scenario, 0)):
        first = max(0, block.count + (-block.count) % every) - block.count
        leans = block.lean[first : len(block.shake) : every, 0] + block.shake[first::every]
        found += [tilted(scenario.camera, one) for one in leans]
        if len(found) >= frames:
            break
    return found[:frames]


@lru_cache(maxsize=1)
def _imu(mount: str, wind: float, clip: int) -> ImuReadings:
    """Record the readings of an inertial sensor in the camera's housing in the same clip."""
    scenario = _clip(mount, wind, clip)[0]
    found, stated = simgrab.sensors(scenario)["imu0"], scenario.sensors["imu0"].errors
    return ImuReadings(
        found.stamp_ns / 1e9, found.values[:, :3], found.values[:, 3:], np.eye(3), stated.gyroscope_noise_density,
        stated.gyroscope_random_walk, stated.accelerometer_noise_density, stated.accelerometer_random_walk,
    )  # fmt: skip


def _wandering(time: Array, rng: np.random.Generator) -> Array:
    """Draw errors (n, 2) of unit variance that are alike for `WANDER_S`."""
    stay = float(np.exp(-np.diff(time).mean() / WANDER_S))
    draws = rng.normal(0, np.sqrt(1 - stay**2), (len(time), 2))
    draws[0] /= np.sqrt(1 - stay**2)
    return lfilter([1.0], [1.0, -stay], draws, axis=0)


def _readings(time: Array, jib: Array, mass: Array, rng: np.random.Generator, reading: Reading) -> Controller:
    """Read the jib's slew angle and radius (n, 2) and the hoisted mass (n,) at times (n,) as a controller does."""
    at = np.arange(time[0], time[-1], 1 / reading["rate_hz"])
    steps = np.array([np.radians(reading["slew_deg"]), reading["radius_m"]])
    values = np.round(CubicSpline(time, jib)(at) / steps) * steps
    values[rng.random(len(at)) < reading["dropout"]] = np.nan
    values[at % MINUTE_S > MINUTE_S - reading["gap_s"]] = np.nan
    slew_sd, radius_sd = (steps / np.sqrt(12)).tolist()
    load = np.round(np.interp(at, time, mass) * rng.normal(1, LOAD_SCALE_SD) / LOAD_STEP_KG) * LOAD_STEP_KG
    return Controller(
        at + reading["lag_s"], values[:, 0], values[:, 1], None, slew_sd, radius_sd, CLOCK_SD_S,
        load=np.column_stack([at + reading["lag_s"], load]) if reading["load"] else None, grab_kg=GRAB_KG,
    )  # fmt: skip


def _wind(weather: str, stated: float | None) -> float:
    return WIND_M_S.get(weather, CALM_M_S) if stated is None else stated


def records(cell: Cell, clip: int, most: int, mean_wind: float | None, reading: Reading) -> Errors:
    """Estimate some records of a clip: squared error of α (deg²), coverage and width (deg) of each; NaN if refused."""
    mount, weather, seconds, given = cell
    wind, (noise, wander) = _wind(weather, mean_wind), ERRORS[weather]
    _, known, time, jib, alpha, rope, exact, mass = _clip(mount, wind, clip)
    size, found, intervals = int(seconds * RATE_HZ), Errors(), replace(WORKING, wind_m_s=wind)
    parts = len(time) // size
    for part in range(0, parts, -(-parts // most)):
        rng, some = stream(0, clip, f"{mount} {weather} {seconds:g} {part}"), slice(part * size, (part + 1) * size)
        t = time[some]
        pixels = exact[some] + rng.normal(0, noise, (size, 2)) + wander * _wandering(t, rng)
        x, y, z = (np.array(known.offset_m) + rng.normal(0, OFFSET_SD_M, 3)).tolist()
        camera = msgspec.structs.replace(known, offset_m=(x, y, z), offset_sd_m=OFFSET_SD_M)
        sd = np.full(size, np.hypot(noise, wander))
        controller = _readings(t, jib[some], mass[some], rng, reading) if given.startswith("controller") else None
        imu = _imu(mount, wind, clip) if given.endswith("imu") else None
        estimator: Estimator = PendulumSmoother(controller=controller, imu=imu, wander_px=wander, intervals=intervals)
        if given == "rope-aware":
            estimator = RopeAware(intervals=intervals)
        length = np.round(rope[some] / ROPE_STEP_M) * ROPE_STEP_M
        estimate = estimator.estimate(pixels, camera, rope_length=length, time=t, pixel_sd=sd)
        if not estimate.ok:
            found.append((np.nan, np.nan, np.nan))
            continue
        found_alpha = np.asarray(estimate.alpha)
        seen = np.isfinite(found_alpha)
        low, high = stated_ends(estimate).T
        error = np.degrees(found_alpha - alpha[some])[seen]
        inside = ((low <= alpha[some]) & (alpha[some] <= high))[seen]
        found.append((np.mean(error**2), np.mean(inside), np.degrees(np.mean((high - low)[seen]))))
    return found


def of_clip(cells: list[Cell], most: int, mean_wind: float | None, reading: Reading, clip: int) -> list[Errors]:
    """Estimate the records of all cells of one clip."""
    return [records(cell, clip, most, mean_wind, reading) for cell in cells]


def _summary(clips: list[Errors]) -> str:
    """Sum up the records of a cell: number, RMSE, coverage with its interval over clips, mean width, refusals."""
    every = np.array([one for clip in clips for one in clip])
    kept = every[np.isfinite(every[:, 0])]
    if not len(kept):
        return f"{len(every)} records | all refused"
    means = np.array([np.nanmean(np.array(clip)[:, 1]) for clip in clips if np.isfinite(np.array(clip)[:, 1]).any()])
    draws = means[stream(0, 0, "resampled").integers(len(means), size=(RESAMPLES, len(means)))].mean(axis=1)
    low, high = np.percentile(100 * draws, [2.5, 97.5])
    square, inside, width = kept.mean(axis=0)
    return (
        f"{len(every)} records | RMSE {np.sqrt(square):.3f}° "
        f"| 95 % hold {100 * inside:.1f} % ({low:.0f} to {high:.0f}) "
        f"| width {width:.2f}° | {len(every) - len(kept)} refused"
    )


@click.command()
@click.option("--mount", "mounts", multiple=True, type=click.Choice(MOUNTS), help="[default: all]")
@click.option("--weather", "weathers", multiple=True, type=click.Choice(list(ERRORS)), help="[default: all]")
@click.option("--seconds", "lengths", multiple=True, type=click.Choice([f"{s:g}" for s in LENGTHS_S]), help="[all]")
@click.option("--input", "inputs", multiple=True, type=click.Choice(INPUTS), help="[default: all]")
@click.option("--first", default=4, show_default=True, help="Clip; 1 to 3 served to set up the estimator.")
@click.option("--clips", default=6, show_default=True, help="Of ten minutes each.")
@click.option("--share", default=30, show_default=True, help="Most records of a clip.")
@click.option("--workers", default=2, show_default=True)
@click.option("--wind-m-s", type=float, help="Mean wind.  [default: of the weather]")
@click.option("--rate-hz", default=20.0, show_default=True, help="Of the controller's readings.")
@click.option("--slew-deg", default=0.044, show_default=True, help="Resolution.")
@click.option("--radius-m", default=0.01, show_default=True, help="Resolution.")
@click.option("--lag-s", default=0.0, show_default=True, help="Of the readings' times, unknown to the estimator.")
@click.option("--dropout", default=0.0, show_default=True, help="Share of readings that get lost.")
@click.option("--load/--no-load", default=True, show_default=True, help="Whether the controller reports it.")
@click.option("--gap-s", default=0.0, show_default=True, help="Of each minute, without readings.")
def main(
    mounts: tuple[str, ...], weathers: tuple[str, ...], lengths: tuple[str, ...], inputs: tuple[str, ...], first: int,
    clips: int, share: int, workers: int, wind_m_s: float | None, **reading: float,
) -> None:  # fmt: skip
    """Print a line for each cell."""
    seconds = tuple(map(float, lengths)) or LENGTHS_S
    cells = list(itertools.product(mounts or MOUNTS, weathers or tuple(ERRORS), seconds, inputs or INPUTS))
    cells.sort(key=lambda cell: (_wind(cell[1], wind_m_s), cell[0]))  # so that a clip is simulated once
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = list(pool.map(partial(of_clip, cells, share, wind_m_s, reading), range(first, first + clips)))
    for cell, of_cell in zip(cells, zip(*found, strict=True), strict=True):
        mount, weather, length, given = cell
        print(f"{mount} | {weather} | {length:g} s | {given} | {_summary(list(of_cell))}", flush=True)


if __name__ == "__main__":
    main()
