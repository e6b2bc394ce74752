"""Print how well sensors on grab and rope measure the swing on each suspension: ``python -m scripts.flattered``.

A free swing of 8° on 20 m, 120 s, without wind; sensors of ADIS16448 class without clock errors. The accelerometer's
angle is that of its specific force against the sensor's own axis. The complementary filter integrates the gyroscope and
follows that angle within 2 s. The pendulum filter is a Kalman filter of swing, rate and bias of a point-mass pendulum,
which takes the gyroscope alone.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np

import simgrab
from simgrab.geometry import STANDARD_GRAVITY, Array

WAVES = {"modes": 3}
SUSPENSIONS: dict[str, dict[str, Any]] = {
    "one body": {"model": "one-body"},
    "four ropes, ratio 1": {"model": "four-rope", "tilt_ratio": 1.0},
    "four ropes, ratio 0.2": {"model": "four-rope", "tilt_ratio": 0.2},
    "four ropes, ratio 0": {"model": "four-rope", "tilt_ratio": 0.0},
    "double pendulum": {"model": "double-pendulum", "damping": 0.02},
    "one body, rope waves": {"model": "one-body", "waves": WAVES},
    "double pendulum, rope waves": {"model": "double-pendulum", "damping": 0.02, "waves": WAVES},
}
ROPE_M, RATE_HZ, FOLLOWS_S = 20.0, 200.0, 2.0


def accelerometer(force: Array) -> Array:
    """Lean of the sensor's z axis along x, rad, where its specific force is taken for the vertical."""
    return np.asarray(np.arctan2(force[:, 0], force[:, 2]))


def complementary(rate: Array, force: Array) -> Array:
    """Lean along x, rad, by the gyroscope, drawn to the accelerometer's with a time constant of `FOLLOWS_S`."""
    share, felt = 1 / (RATE_HZ * FOLLOWS_S), accelerometer(force)
    lean = np.empty(len(rate))
    now = float(felt[0])
    for i, (turned, level) in enumerate(zip(-rate[:, 1] / RATE_HZ, felt, strict=True)):
        now += turned + share * (level - now)
        lean[i] = now
    return lean


def pendulum(rate: Array) -> Array:
    """Swing along x, rad, by a Kalman filter of a point-mass pendulum, [θ, θ̇, bias], from the gyroscope alone."""
    step, theta = 1 / RATE_HZ, np.zeros(len(rate))
    square = STANDARD_GRAVITY / ROPE_M
    move = np.array([[1, step, 0], [-square * step, 1, 0], [0, 0, 1]])
    drift, noise = np.diag([1e-10, 1e-8, 1e-12]), 1e-4
    state, spread, sees = np.zeros(3), np.diag([0.02, 0.02, 1e-4]), np.array([0.0, 1.0, 1.0])
    for i, measured in enumerate(-rate[:, 1]):
        state, spread = move @ state, move @ spread @ move.T + drift
        gain = spread @ sees / (sees @ spread @ sees + noise)
        state = state + gain * (measured - sees @ state)
        spread = spread - np.outer(gain, sees @ spread)
        theta[i] = state[0]
    return theta


def errors(suspension: dict[str, Any], seconds: float) -> dict[str, float]:
    """RMS errors of the swing along x after the first quarter, degrees, by method."""
    imus = {
        name: {"model": "imu", "mount": name, "noise": "adis16448", "rate_hz": RATE_HZ} for name in ("rope", "grab")
    }
    scene = simgrab.load("free-swing", {
        "frames": round(9 * seconds), "clip.frame_rate_hz": 9.0, "sensors": imus, "suspension": suspension,
        "swing.work": {"model": "hang", "rope_length_m": ROPE_M}, "swing.start": {"alpha_deg": 8.0},
        "swing.wind.mean_m_s": 0.0, "swing.forcing.rms_m_s2": 0.0,
    })  # fmt: skip
    found: dict[str, float] = {}
    for name, read in simgrab.sensors(scene).items():
        rate, force = read.values[:, :3], read.values[:, 3:]
        alpha, azimuth = np.radians(read.true("alpha [deg]")), np.radians(read.true("azimuth [deg]"))
        true = np.arctan(np.tan(alpha) * np.cos(azimuth))
        late = slice(len(true) // 4, None)
        for method, lean in (
            ("accelerometer", accelerometer(force)), ("complementary filter", complementary(rate, force)),
            ("pendulum filter", pendulum(rate)),
        ):  # fmt: skip
            found[f"{method}, {name}"] = float(np.degrees(np.sqrt(np.mean((lean - true)[late] ** 2))))
        at = read.truth_columns.index
        felt, clean = read.truth[:, at("a_RS_S_x [m s^-2]")], STANDARD_GRAVITY * np.sin(true)
        found[f"gain, {name}"] = float((felt @ clean) / (clean @ clean))
    return found


@click.command()
@click.option("--seconds", default=120.0, show_default=True)
def main(seconds: float) -> None:
    """Print the table."""
    first = True
    for name, suspension in SUSPENSIONS.items():
        found = errors(suspension, seconds)
        if first:
            print("| suspension | " + " | ".join(found) + " |", "|---|" + "---|" * len(found), sep="\n")
            first = False
        print(f"| {name} | " + " | ".join(f"{value:.3f}" for value in found.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
