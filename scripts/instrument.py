"""Print what the estimators make of the world's own motion: errors of α, coverage and alarms, without pictures.

    python -m scripts.instrument [--clips 6] [--noise-px 1.5]

Clips of five minutes at 9 frames/s, whose observations are the truth and noise; the camera hangs 0.6 m beside the rope
exit, and each clip has a camera file whose offset errs by 5 cm per coordinate. ``given``: the tilt comes from ten
minutes of calm cycles beforehand. This is what the default estimator was chosen by.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np

from simgrab.instrument.alarm import Rule, events
from simgrab.instrument.estimate import ESTIMATORS, RopeAware
from simgrab.instrument.pipeline import INTERVALS, Pipeline
from simgrab.instrument.read import Reader
from simgrab.judge.evaluate import swings
from simgrab.model.records.observations import Detection
from simgrab.model.rng import stream

# The records are those of the tests, at full length.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import swinging  # type: ignore[import-not-found]

FRAMES = 2700
CALM = 5400
OFFSET_SD_M = 0.05
WORLDS: dict[str, tuple[str, bool, dict[str, Any]]] = {
    "calm": ("work-cycles", True, {}),
    "windy, 14 m/s": ("work-cycles", True, {"swing__wind": {"mean_m_s": 14.0}}),
    "alarm-cycles": ("alarm-cycles", True, {}),
    "calm, levelled camera": ("work-cycles", False, {}),
    "alarm-cycles, levelled camera": ("alarm-cycles", False, {"camera__mount": {"model": "levelled"}}),
}


def nobody(_picture: Any) -> Detection:
    """Stand where a detector would: these records have no pictures."""
    raise AssertionError


def measure(world: str, clips: int, noise: float) -> dict[str, dict[str, Any]]:
    """Measure clips of a world by every estimator, all clips together."""
    scene, fixed, changes = WORLDS[world]
    kinds = [*ESTIMATORS, "rope-aware, given"]
    together: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    for clip in range(clips):
        truth = swinging.record(scene, fixed=fixed, frames=FRAMES, seed=100 + clip, **changes)
        off = stream(0, clip, "offset").normal(0, OFFSET_SD_M, 3)
        x, y, z = (np.array(truth.calibration.offset_m) + off).tolist()
        camera = msgspec.structs.replace(truth.calibration, offset_m=(x, y, z), offset_sd_m=OFFSET_SD_M)
        for kind in kinds:
            estimator = ESTIMATORS.get(kind, RopeAware)(intervals=INTERVALS)
            pipeline = Pipeline(nobody, Reader(), estimator)  # type: ignore[arg-type]
            if kind.endswith("given"):
                kept = {key: value for key, value in changes.items() if key == "camera__mount"}
                calm = swinging.record("work-cycles", fixed=fixed, frames=CALM, seed=200 + clip, **kept)
                tilt = pipeline.conclude(calm.observations(noise, 50 + clip), camera).tilt
                pipeline = dataclasses.replace(pipeline, tilt=tilt)
            together[kind].append(one(pipeline, truth, camera, noise, clip))
    return {kind: pooled(found) for kind, found in together.items()}


def one(pipeline: Pipeline, truth: Any, camera: Any, noise: float, clip: int) -> dict[str, Any]:
    """Measure one clip."""
    found = pipeline.conclude(truth.observations(noise, clip), camera).measurements
    alpha = np.array([np.nan if m.alpha is None else m.alpha for m in found], float)
    alarms = swings.alarms(truth.time, found, events(truth.time, found), truth.alpha, Rule())
    return alarms | {"error": alpha - truth.alpha, "coverage": swings.coverage(found, truth.alpha)}


def pooled(clips: list[dict[str, Any]]) -> dict[str, Any]:
    """Put clips together."""
    error = np.concatenate([clip["error"] for clip in clips])
    counts = {name: sum(clip[name] for clip in clips) for name in ("events", "sure", "missed", "reported", "false")}
    delays = [delay for clip in clips for delay in clip["delays"]]
    shares = [clip["coverage"]["share"] for clip in clips if clip["coverage"]["share"] is not None]
    refused = sum(bool(np.isnan(clip["error"]).all()) for clip in clips)
    return swings.errors(error, np.zeros_like(error)) | counts | {
        "delays": delays, "coverage": float(np.mean(shares)) if shares else float("nan"), "refused": refused,
    }  # fmt: skip


@click.command()
@click.option("--clips", default=6, show_default=True)
@click.option("--noise-px", default=1.5, show_default=True, help="Per coordinate, 1920 px across.")
def main(clips: int, noise_px: float) -> None:
    """Print the tables."""
    print(f"{clips} clips of {FRAMES} frames, noise {noise_px:g} px, offset off by {100 * OFFSET_SD_M:g} cm")
    for world in WORLDS:
        print(f"\n{world}")
        for kind, f in measure(world, clips, noise_px).items():
            if f["rmse_deg"] is None:
                print(f"  {kind:20s} refused")
                continue
            delay = f"{np.median(f['delays']):g} ({min(f['delays'])} to {max(f['delays'])})" if f["delays"] else "-"
            print(
                f"  {kind:20s} α: bias {f['bias_deg']:+.3f}°, RMSE {f['rmse_deg']:.3f}°, max {f['max_deg']:.2f}°; "
                f"95 % hold {100 * f['coverage']:.0f} %; events {f['events']} ({f['sure']} sure), "
                f"missed {f['missed']}, alarms {f['reported']}, false {f['false']}, delay {delay}"
                + (f"; {f['refused']} clips refused" if f["refused"] else ""),
                flush=True,
            )


if __name__ == "__main__":
    main()
