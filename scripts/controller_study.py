"""Print errors of α and their coverage with a controller's readings of slew angle and radius, without pictures.

    python -m scripts.controller_study [--world "levelled, calm"] [--clips 6] [--rate-hz 20] [--slew-deg 0.044] …

The estimator gets the true grab centre with noise, the rope length in centimetres, an offset with an error of 5 cm per
coordinate, and readings in steps of their resolution.
"""

from __future__ import annotations

from typing import Any

import click
import msgspec
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from simgrab.dataset.tables import calibration_of
from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import PendulumSmoother
from simgrab.instrument.estimate.pendulum_smoother import WANDER_S
from simgrab.model import scenes
from simgrab.model.geometry import Array, to_camera
from simgrab.model.rng import stream
from simgrab.world.trajectory.trajectory import Trajectory

WIND = {"swing.wind": {"mean_m_s": 14.0}}
WORLDS: dict[str, dict[str, Any]] = {
    f"{mount}, {name}": {"camera.mount": {"model": mount}, **wind}
    for mount in ("levelled", "fixed", "rigid")
    for name, wind in (("calm", {}), ("14 m/s", WIND))
}
MINUTE_S = 60.0
OFFSET_SD_M, ROPE_STEP_M, CLOCK_SD_S = 0.05, 0.01, 1.0


@click.command()
@click.option("--world", "worlds", multiple=True, type=click.Choice(list(WORLDS)), help="[default: all]")
@click.option("--first", default=4, show_default=True, help="Clip; 1 to 3 served to set up the estimator.")
@click.option("--clips", default=6, show_default=True)
@click.option("--frames", default=2700, show_default=True, help="Of each clip, 9 a second.")
@click.option("--noise-px", default=1.3, show_default=True, help="Per coordinate, 1920 px across.")
@click.option("--wander-px", default=0.0, show_default=True, help="Of errors that last for some seconds.")
@click.option("--rate-hz", default=20.0, show_default=True)
@click.option("--slew-deg", default=0.044, show_default=True, help="Resolution.")
@click.option("--radius-m", default=0.01, show_default=True, help="Resolution.")
@click.option("--lag-s", default=0.0, show_default=True, help="Of the readings' times, unknown to the estimator.")
@click.option("--dropout", default=0.0, show_default=True, help="Share of readings that get lost.")
@click.option("--gap-s", default=0.0, show_default=True, help="Of each minute, without readings.")
@click.option("--without", is_flag=True, help="Without a controller.")
def main(
    worlds: tuple[str, ...],
    first: int,
    clips: int,
    frames: int,
    noise_px: float,
    wander_px: float,
    without: bool,
    **reading: float,
) -> None:
    """Print one line for each world."""
    for world in worlds or WORLDS:
        errors, held, refused = [], [], 0
        for clip in range(first, first + clips):
            rng, changes = stream(0, clip, "controller"), WORLDS[world]
            scenario = scenes.load(
                "work-cycles", {"frames": frames, "seed": 100 + clip, "clip.clip_frames": frames, **changes}
            )
            story, known = Trajectory(scenario), calibration_of(scenario)
            moments = [story.at(frame) for frame in range(frames)]
            time = np.array([m.time for m in moments])
            jib = np.array([(m.jib.slew, m.jib.radius) for m in moments if m.jib])
            alpha = np.array([m.grab.alpha for m in moments])
            rope = np.array([m.grab.rope_length for m in moments])
            centre = np.array([m.grab.jib_from_grab.translation for m in moments])
            turn = np.array([m.tilt.jib_from_camera for m in moments])
            pixels = known.intrinsics.project(to_camera(centre, turn, np.array(known.offset_m)))
            x, y, z = (np.array(known.offset_m) + rng.normal(0, OFFSET_SD_M, 3)).tolist()
            controller = None if without else _readings(time, jib, rng, **reading)
            pixels += rng.normal(0, noise_px, pixels.shape) + wander_px * _wandering(time, rng)
            found = PendulumSmoother(controller=controller, wander_px=wander_px).estimate(
                pixels,
                msgspec.structs.replace(known, offset_m=(x, y, z), offset_sd_m=OFFSET_SD_M),
                rope_length=np.round(rope / ROPE_STEP_M) * ROPE_STEP_M,
                time=time,
            )
            if not found.ok:
                refused += 1
                continue
            low, high = np.asarray(found.interval("posterior").alpha).T
            errors.append(np.degrees(found.alpha - alpha))
            held.append((low <= alpha) & (alpha <= high))
        rmse = np.sqrt(np.mean(np.square(errors)))
        each = ", ".join(f"{np.sqrt(np.mean(e**2)):.2f}" for e in errors)
        print(
            f"{world:16s} RMSE {rmse:.3f}° ({each}); 95 % hold {100 * np.mean(held):.1f} %; {refused} refused",
            flush=True,
        )


def _wandering(time: Array, rng: np.random.Generator) -> Array:
    """Draw errors (n, 2) of unit variance that are alike for `WANDER_S`."""
    stay = float(np.exp(-np.diff(time).mean() / WANDER_S))
    draws = rng.normal(0, np.sqrt(1 - stay**2), (len(time), 2))
    draws[0] /= np.sqrt(1 - stay**2)
    return lfilter([1.0], [1.0, -stay], draws, axis=0)


def _readings(
    time: Array, jib: Array, rng: np.random.Generator, rate_hz: float, slew_deg: float, radius_m: float, lag_s: float,
    dropout: float, gap_s: float,
) -> Controller:  # fmt: skip
    """Read the jib's slew angle and radius (n, 2) at times (n,) as a controller does."""
    at, steps = np.arange(time[0], time[-1], 1 / rate_hz), np.array([np.radians(slew_deg), radius_m])
    true = CubicSpline(time, jib)(at)
    values = np.round(true / steps) * steps
    values[rng.random(len(at)) < dropout] = np.nan
    values[at % MINUTE_S > MINUTE_S - gap_s] = np.nan
    slew_sd, radius_sd = (steps / np.sqrt(12)).tolist()
    return Controller(at + lag_s, values[:, 0], values[:, 1], None, slew_sd, radius_sd, 0.0, CLOCK_SD_S)


if __name__ == "__main__":
    main()
