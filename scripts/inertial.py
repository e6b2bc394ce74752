"""Print what an inertial sensor in the camera's housing adds: errors of α, coverage and alarms, without pictures.

    python -m scripts.inertial [--clips 6] [--frames 2700] [--noise-px 1.5] [--world NAME …] [--suspension KIND]

The clips, cameras and noise are those of ``scripts/instrument.py``; beside `rope-aware` each is measured by
`inertial-fusion` with two classes of sensors.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np

import simgrab
from scripts.instrument import OFFSET_SD_M, nobody, one, pooled
from simgrab import scenes
from simgrab.instrument.estimate import InertialFusion, RopeAware
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.pipeline import INTERVALS, Pipeline
from simgrab.instrument.read import Reader
from simgrab.rng import stream

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import swinging  # type: ignore[import-not-found]

WIND = {"swing.wind": {"mean_m_s": 14.0}}
MOUNTS: dict[str, dict[str, Any]] = {name: {"camera.mount": {"model": name}} for name in ("levelled", "rigid", "fixed")}
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"calm, {name}": ("work-cycles", mount) for name, mount in MOUNTS.items()},
    **{f"wind of 14 m/s, {name}": ("work-cycles", WIND | mount) for name, mount in MOUNTS.items()},
    "alarm-cycles, levelled": ("alarm-cycles", MOUNTS["levelled"]),
}
SUSPENSIONS: dict[str, dict[str, Any]] = {
    "one-body": {},
    "four-rope": {"suspension": {"model": "four-rope", "tilt_ratio": 0.2}},
    "double-pendulum": {"suspension": {"model": "double-pendulum"}},
}
CLASSES = ("adis16448", "mems")


def readings(scene: str, changes: dict[str, Any], noise: str) -> ImuReadings:
    """Record the readings of a sensor in the camera's housing in the same clip."""
    sensor = {"model": "imu", "mount": "camera", "noise": noise}
    scenario = scenes.load(scene, {"display.layout": "two-by-four", **changes, "sensors.imu0": sensor})
    recorded, stated = simgrab.sensors(scenario)["imu0"], scenario.sensors["imu0"].errors  # type: ignore[union-attr]
    return ImuReadings(
        recorded.stamp_ns / 1e9, recorded.values[:, :3], recorded.values[:, 3:], np.eye(3),
        stated.gyroscope_noise_density, stated.gyroscope_random_walk, stated.accelerometer_noise_density,
        stated.accelerometer_random_walk,
    )  # fmt: skip


def measure(world: str, clips: int, frames: int, noise: float, suspension: str) -> dict[str, dict[str, Any]]:
    """Measure clips of a world, all of them together."""
    scene, changes = WORLDS[world]
    kinds = ("rope-aware", *(f"inertial-fusion, {name}" for name in CLASSES))
    together: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    seconds: list[float] = []
    for clip in range(clips):
        every = {"frames": frames, "seed": 100 + clip, **changes, **SUSPENSIONS[suspension]}
        truth = swinging.record(scene, fixed=False, **{key.replace(".", "__"): value for key, value in every.items()})
        off = stream(0, clip, "offset").normal(0, OFFSET_SD_M, 3)
        x, y, z = (np.array(truth.calibration.offset_m) + off).tolist()
        camera = msgspec.structs.replace(truth.calibration, offset_m=(x, y, z), offset_sd_m=OFFSET_SD_M)
        for kind in kinds:
            estimator: Any = RopeAware(intervals=INTERVALS)
            if kind != "rope-aware":
                imu = readings(scene, every, kind.rpartition(" ")[2])
                estimator = InertialFusion(imu=imu, intervals=INTERVALS)
            pipeline = Pipeline(nobody, Reader(), estimator)  # type: ignore[arg-type]
            begun = time.process_time()
            together[kind].append(one(pipeline, truth, camera, noise, clip))
            if kind != "rope-aware":
                seconds.append(time.process_time() - begun)
    return {kind: pooled(found) | {"seconds": float(np.mean(seconds))} for kind, found in together.items()}


@click.command()
@click.option("--clips", default=6, show_default=True)
@click.option("--frames", default=2700, show_default=True)
@click.option("--noise-px", default=1.5, show_default=True, help="Per coordinate, 1920 px across.")
@click.option("--suspension", default="one-body", show_default=True, type=click.Choice(list(SUSPENSIONS)))
@click.option("--world", "worlds", multiple=True, type=click.Choice(list(WORLDS)), help="[default: all]")
def main(clips: int, frames: int, noise_px: float, suspension: str, worlds: tuple[str, ...]) -> None:
    """Print the tables."""
    print(
        f"{suspension}: {clips} clips of {frames} frames, noise {noise_px:g} px, offset off by {100 * OFFSET_SD_M:g} cm"
    )
    for world in worlds or WORLDS:
        print(f"\n{world}")
        for kind, f in measure(world, clips, frames, noise_px, suspension).items():
            if f["rmse_deg"] is None:
                print(f"  {kind:27s} refused")
                continue
            print(
                f"  {kind:27s} α: bias {f['bias_deg']:+.3f}°, RMSE {f['rmse_deg']:.3f}°, max {f['max_deg']:.2f}°; "
                f"95 % hold {100 * f['coverage']:.0f} %; events {f['events']} ({f['sure']} sure), "
                f"missed {f['missed']}, alarms {f['reported']}, false {f['false']}; {f['refused']} refused"
                + (f"; {f['seconds']:.0f} s of CPU a clip" if kind != "rope-aware" else ""),
                flush=True,
            )


if __name__ == "__main__":
    main()
