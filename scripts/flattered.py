"""Print how well sensors on grab and rope measure the swing on each suspension: ``python -m scripts.flattered``.

A free swing of 8° on 20 m, 120 s, without wind; sensors of ADIS16448 class. The methods are those of
`simgrab.instrument.rivals.inertial`: the lean of the specific force, an attitude and heading reference system, and a
Kalman filter of a pendulum whose rates the gyroscope reads. The gain is that of the specific force without errors.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np

import simgrab
from scripts.rivals import imu_readings
from simgrab.geometry import STANDARD_GRAVITY
from simgrab.instrument.rivals.contract import Sensors, Series
from simgrab.instrument.rivals.inertial import accelerometer, ahrs, gyro_pendulum

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
METHODS = {"accelerometer": accelerometer, "AHRS": ahrs, "pendulum filter": gyro_pendulum}
ROPE_M = 20.0


def errors(suspension: dict[str, Any], seconds: float) -> dict[str, float]:
    """RMS errors of the swing along x after the first quarter, degrees, by method."""
    imus = {name: {"model": "imu", "mount": name, "noise": "adis16448"} for name in ("rope", "grab")}
    scene = simgrab.load("free-swing", {
        "frames": round(9 * seconds), "clip.frame_rate_hz": 9.0, "sensors": imus, "suspension": suspension,
        "swing.work": {"model": "hang", "rope_length_m": ROPE_M}, "swing.start": {"alpha_deg": 8.0},
        "swing.wind.mean_m_s": 0.0, "swing.forcing.rms_m_s2": 0.0,
    })  # fmt: skip
    recorded = simgrab.sensors(scene)
    ends = np.array([0.0, seconds])
    sensors = Sensors(
        {name: imu_readings(one, scene) for name, one in recorded.items()}, rope=Series(ends, np.full((2, 1), ROPE_M))
    )
    found: dict[str, float] = {}
    for name, one in recorded.items():
        time = one.true("time [s]")
        alpha, azimuth = np.radians(one.true("alpha [deg]")), np.radians(one.true("azimuth [deg]"))
        true = np.arctan(np.tan(alpha) * np.cos(azimuth))
        for method, made in METHODS.items():
            swing = made(name)(sensors, time)
            error = np.arctan(np.tan(swing.alpha) * np.cos(swing.azimuth)) - true
            found[f"{method}, {name}"] = float(np.degrees(np.sqrt(np.nanmean(error[len(true) // 4 :] ** 2))))
        felt, clean = one.true("a_RS_S_x [m s^-2]"), STANDARD_GRAVITY * np.sin(true)
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
