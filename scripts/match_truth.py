"""Prove `simgrab match` by truth: ``python -m scripts.match_truth render|score FOLDER``.

``render`` draws scenes at random over the scenario's ranges, none of them bundled, and renders a video of each: optics,
sensor, coder, display, weather and paint are known. ``score`` matches each video, which sees its pixels alone, and
compares with the scenes: coverage of stated intervals, errors, and displays found.
"""

from __future__ import annotations

import colorsys
import math
from pathlib import Path
from typing import Any

import click
import numpy as np

from simgrab import scenes
from simgrab.rng import stream
from simgrab.scenario import Scenario

SIZES = ((640, 360), (960, 540))
SECONDS = 5.0
PLACES: tuple[dict[str, Any], ...] = (
    {"model": "quay", "cargo": "coal"}, {"model": "quay", "cargo": "grain", "receiver": "truck"},
    {"model": "quay", "cargo": "bauxite", "receiver": "none"}, {"model": "hold", "cargo": "ore"}, {"model": "water"},
    {"model": "plain"},
)  # fmt: skip


def drawn(number: int) -> Scenario:
    """Draw scene ``number``."""
    rng = stream(3207, number, "match.truth")
    width, height = SIZES[int(rng.random() < 0.3)]
    night = rng.random() < 0.15
    rate = float(rng.choice([9.0, 12.5, 15.0]))
    grey = rng.random() < 0.2
    changes: dict[str, Any] = {
        "seed": number,
        "frames": math.ceil(SECONDS * rate),
        "clip.frame_rate_hz": rate,
        "clip.gop_frames": int(rng.integers(20, 61)),
        "clip.bit_rate_mbit_s": float(np.exp(rng.uniform(np.log(4.0), np.log(40.0)))) * width / 960,
        "swing": {
            "model": "dynamic",
            "work": {"model": "hang", "rope_length_m": float(rng.uniform(10, 24))} if rng.random() < 0.8
            else {"model": "cycles"},
            "settle_s": 0.0,
            "start": {"alpha_deg": float(rng.uniform(1, 6))},
        },
        "camera.mount": {"model": "fixed"},
        "camera.beta_deg": float(rng.uniform(0, 6)),
        "camera.tilt_azimuth_deg": float(rng.uniform(-180, 180)),
        "place": PLACES[int(rng.integers(len(PLACES)))],
        "grab.paint_rgb": [round(v, 3) for v in colorsys.hsv_to_rgb(rng.random(), 0.75, 0.75)],
        "grab.wear": float(rng.uniform(0, 0.6)),
        "optics.vignetting_stops": float(rng.choice([0.0, rng.uniform(0, 2.5)], p=[0.15, 0.85])),
        "optics.defocus_px": float(rng.choice([0.0, rng.uniform(1, 6)], p=[0.2, 0.8])),
        "optics.exposure": {"model": "fixed", "exposure_ev": float(rng.uniform(-0.7, 0.5))},
        "optics.sensor.full_well_e": float(np.exp(rng.uniform(np.log(400), np.log(8000)))),
        "optics.sensor.read_noise_e": float(rng.choice([0.0, rng.uniform(2, 15)], p=[0.2, 0.8])),
        "optics.sensor.fixed_pattern_percent": float(rng.choice([0.0, rng.uniform(0.3, 2)], p=[0.4, 0.6])),
        "optics.night_mode": "on" if grey else "off",
        "light.sun_elevation_deg": float(rng.uniform(25, 75)),
        "light.sun_azimuth_deg": float(rng.uniform(-180, 180)),
    }
    if night:
        changes |= {"light.sun": 0.0, "light.sky": 0.05, "light.floodlights": float(rng.uniform(0.4, 0.8))}
    weather = rng.choice(["none", "fog", "rain", "snow"], p=[0.6, 0.15, 0.15, 0.1])
    if weather == "fog":
        changes["weather.visibility_m"] = float(rng.uniform(60, 400))
    elif weather == "rain":
        changes["weather.rain_mm_h"] = float(rng.uniform(5, 40))
    elif weather == "snow":
        changes["weather.snow_mm_h"] = float(rng.uniform(0.3, 2))
    layout = rng.choice(["none", "two-by-four", "four-point-four", "own"], p=[0.35, 0.25, 0.2, 0.2])
    changes["display.layout"] = own_layout(rng) if layout == "own" else str(layout)
    return scenes.load("quay-day", changes | {"name": f"match-{number:03d}"}, size=(width, height))


def own_layout(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a layout that is not bundled: size, pitch, and where the numbers stand."""
    w = int(rng.integers(24, 41))
    h = int(w * rng.uniform(1.4, 1.7))
    gap = int(rng.integers(2, 9))
    x = int(rng.integers(40, 1880 - 4 * (w + gap)))
    y = int(rng.integers(200, 1040 - 3 * h))
    row = [[x + i * (w + gap), y] for i in range(4)]
    below = [[u, v + int(1.4 * h)] for u, v in row]
    clock = {"x_px": int(rng.integers(20, 400)), "y_px": int(rng.integers(20, 100)), "size_px": int(rng.integers(36, 56))}
    return {
        "width_px": 1920, "height_px": 1080, "clock": clock, "digit_width_px": w, "digit_height_px": h,
        "hoist_px": row, "closing_px": below,
    }  # fmt: skip


@click.group(help=(__doc__ or "").partition("\n")[0])
def main() -> None:
    """Render, then score."""


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--count", default=30, show_default=True)
@click.option("--first", default=0, show_default=True)
def render(folder: Path, count: int, first: int) -> None:
    """Render videos into FOLDER."""
    from simgrab.world.output.video.render import render_video

    folder.mkdir(parents=True, exist_ok=True)
    for number in range(first, first + count):
        path = folder / f"{number:03d}.mp4"
        if not path.exists():
            made = render_video(drawn(number), path)
            click.echo(f"{path}: {made.frames} frames, {made.mbit_s:.1f} Mbit/s")


if __name__ == "__main__":
    main()
