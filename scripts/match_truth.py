"""Prove `simgrab match` by truth: ``python -m scripts.match_truth render|score FOLDER``.

``render`` draws scenes at random over the scenario's ranges, none of them bundled, and renders a video of each: optics,
sharpening, sensor, coder, display, weather and paint are known. With ``--blender PYTHON``, an interpreter that can
import bpy (GPL; simgrab does not depend on it), the light before the lens is path-traced, with other materials, another
yard and another sky, and the display has another font; the camera is the scene's. ``score`` matches each video by its
pixels alone, and compares with the scenes: coverage of stated intervals, errors, and displays found.
"""

from __future__ import annotations

import colorsys
import dataclasses
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

import simgrab
from scripts.foreign.camera import before_coding
from scripts.foreign.clips import BY_BLENDER, blender, traced
from scripts.foreign.worlds import levelled
from simgrab.dataset.video.coder import Coder
from simgrab.errors import ScenarioError
from simgrab.io import pictures
from simgrab.io.files import drafted, write
from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.match.footage import Appearance, Footage, Quantity
from simgrab.match.footage.footage import BT709
from simgrab.match.footage.sharpness import noise_gain, sharpness
from simgrab.model import scenes
from simgrab.model.layouts import Layout
from simgrab.model.rng import stream
from simgrab.model.scenario import FixedExposure, Scenario

SIZES = ((640, 360), (960, 540))
SECONDS, FOREIGN_SECONDS = 5.0, 3.0
SHARPENED = 0.5  # share of the videos, and of those with a colour cast
CLEAN = 8  # frames, for what a picture would show without noise and coding
FOREIGN = (*BY_BLENDER, "digits")  # what path-traced videos do not have of simgrab
PLACES: tuple[dict[str, Any], ...] = (
    {"model": "quay", "cargo": "coal"}, {"model": "quay", "cargo": "grain", "receiver": "truck"},
    {"model": "quay", "cargo": "bauxite", "receiver": "none"}, {"model": "hold", "cargo": "ore"}, {"model": "water"},
    {"model": "plain"},
)  # fmt: skip


@dataclass(frozen=True)
class Video:
    """One video: its number, and whether its light is path-traced."""

    number: int
    foreign: bool

    @property
    def name(self) -> str:
        """Name of its file, without the suffix."""
        return f"foreign-{self.number:03d}" if self.foreign else f"{self.number:03d}"

    @property
    def scenario(self) -> Scenario:
        """Its scene: where light is path-traced, by day over a level yard, without weather or automatic exposure."""
        return levelled(drawn(self.number, foreign=True)) if self.foreign else drawn(self.number)


def drawn(number: int, *, foreign: bool = False) -> Scenario:
    """Draw scene ``number``."""
    rng = stream(3207, number, "match.truth")
    width, height = SIZES[int(rng.random() < 0.3 and not foreign)]
    night = rng.random() < 0.15 and not foreign
    rate = float(rng.choice([9.0, 12.5, 15.0]))
    grey = rng.random() < 0.2
    changes: dict[str, Any] = {
        "seed": number,
        "frames": math.ceil((FOREIGN_SECONDS if foreign else SECONDS) * rate),
        "clip.frame_rate_hz": rate,
        "clip.gop_frames": int(rng.integers(20, 61)),
        "clip.bit_rate_mbit_s": float(np.exp(rng.uniform(np.log(4.0), np.log(40.0)))) * width / 960,
        "swing": {
            "model": "dynamic",
            "work": {"model": "hang", "rope_length_m": float(rng.uniform(10, 24))}
            if rng.random() < 0.8
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
    if foreign:
        weather = "none"
        changes |= {"place": {"model": "plain"}, "optics.exposure": {"model": "fixed"}}
        changes |= {"shutter.exposure_s": 0.0, "shutter.rolling_s": 0.0}
    if weather == "fog":
        changes["weather.visibility_m"] = float(rng.uniform(60, 400))
    elif weather == "rain":
        changes["weather.rain_mm_h"] = float(rng.uniform(5, 40))
    elif weather == "snow":
        changes["weather.snow_mm_h"] = float(rng.uniform(0.3, 2))
    layout = rng.choice(["none", "two-by-four", "four-point-four", "own"], p=[0.35, 0.25, 0.2, 0.2])
    changes["display.layout"] = own_layout(rng) if layout == "own" else str(layout)
    if rng.random() < SHARPENED:
        changes |= {
            "optics.sharpening.amount": float(rng.uniform(0.3, 3)),
            "optics.sharpening.radius_px": float(rng.uniform(1.5, 6)),
        }
    if rng.random() < SHARPENED:
        changes["optics.white_balance"] = [round(float(gain), 3) for gain in np.exp(rng.normal(0, 0.15, 3))]
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
    clock = {
        "x_px": int(rng.integers(20, 400)),
        "y_px": int(rng.integers(20, 100)),
        "size_px": int(rng.integers(36, 56)),
    }
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
@click.option("--blender", "python", metavar="PYTHON", help="Path-trace them by an interpreter that can import bpy.")
@click.option("--samples", default=4, show_default=True, help="Of the path tracer, a pixel; it denoises.")
def render(folder: Path, count: int, first: int, python: str | None, samples: int) -> None:
    """Render videos into FOLDER."""
    from simgrab.dataset.video.render import render_video

    folder.mkdir(parents=True, exist_ok=True)
    for number in range(first, first + count):
        video = Video(number, python is not None)
        path = folder / f"{video.name}.mp4"
        if path.exists():
            continue
        try:
            if python:
                path_trace(video, path, python, samples)
                click.echo(f"{path}: {video.scenario.frames} frames")
            else:
                made = render_video(video.scenario, path)
                click.echo(f"{path}: {made.frames} frames, {made.mbit_s:.1f} Mbit/s")
        except ScenarioError as problem:  # a draw that cannot be, such as a grab in the ground
            click.echo(f"{path}: {problem}")


def path_trace(video: Video, path: Path, python: str, samples: int) -> None:
    """Write a video of path-traced light, and some of its frames without noise and coding beside it.

    Frames share the path tracer's noise, so that what stands still differs from frame to frame by the sensor alone.
    """
    scenario, ticks_per_s = video.scenario, 90_000
    job = {
        "replaced": list(BY_BLENDER), "dusk": False, "seed": video.number, "samples": samples, "threads": 1,
        "grain": False,
    }  # fmt: skip
    clean = without_noise(scenario)
    with (
        drafted(path) as draft,
        Coder(draft, "mp4", ticks_per_s, scenario.camera, scenario.clip) as coder,
    ):
        for frame, buffers, light in traced(scenario, range(scenario.frames), job, blender(python)):
            wanted = [scenario, clean] if frame % clean_step(scenario.frames) == 0 else [scenario]
            rgb, *others = (
                before_coding(
                    each, buffers, light, FOREIGN, stream(video.number, 0, "match.camera"), np.random.default_rng(0)
                )
                for each in wanted
            )
            coder.send(rgb, round(frame * ticks_per_s / scenario.clip.frame_rate_hz))
            for other in others:
                write(clean_file(path, frame), pictures.encode(cv2.cvtColor(other, cv2.COLOR_RGB2BGR), "png"))


def clean_file(path: Path, frame: int) -> Path:
    """Path of a frame of a path-traced video without noise and coding."""
    return path.with_suffix("") / f"{frame:03d}.png"


def clean_step(frames: int) -> int:
    """Of how many frames one is also made without noise and coding."""
    return max(frames // CLEAN, 1)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--first", default=0, show_default=True)
@click.option("--count", default=40, show_default=True)
def score(folder: Path, first: int, count: int) -> None:
    """Match the videos of FOLDER that were made, and compare with their scenes."""
    from simgrab.instrument.detect import detector
    from simgrab.match.footage import measure, read

    find, kept = detector(), folder / "score.jsonl"
    done = [json.loads(line) for line in kept.read_text("utf-8").splitlines()] if kept.exists() else []
    known = {(row["video"], row["foreign"]) for row in done}
    videos = [Video(number, foreign) for foreign in (False, True) for number in range(first, first + count)]
    for video in videos:
        path = folder / f"{video.name}.mp4"
        if path.exists() and (video.number, video.foreign) not in known:
            night = video.scenario.light.floodlights > 0  # users know when it was
            done.append(compared(video, path, measure(read(path), find, night=night)))
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(done[-1]) + "\n")
    rows = [row for row in done if first <= row["video"] < first + count]
    foreign = [row for row in rows if row["foreign"]]
    click.echo(tables(rows))
    if foreign and len(foreign) < len(rows):
        click.echo("\nOf these, with path-traced light:\n\n" + tables(foreign))


def truths(scenario: Scenario) -> dict[str, float | None]:
    """Give what `simgrab match` should find; None for what the scene does not have."""
    optics, camera, mask = scenario.optics, scenario.camera, scenario.optics.sharpening
    gain, balance = noise(scenario), balanced(scenario)
    raised = noise_gain(mask.amount, mask.radius_px)  # noise is measured as the picture has it
    hue = 360 * colorsys.rgb_to_hsv(*scenario.grab.paint_rgb)[0]
    return {
        "width": camera.width_px, "height": camera.height_px, "frame rate": scenario.clip.frame_rate_hz,
        "key frames": scenario.clip.gop_frames, "noise gain": raised * balance[0] * gain,
        "read noise": math.sqrt(raised * balance[1]) * gain * optics.sensor.read_noise_e,
        "blur": max(optics.defocus_px, 1.0), "vignetting": optics.vignetting_stops,
        "overshoot": None, "hue": None if optics.night_mode == "on" else hue,
        "grey": float(optics.night_mode == "on"),
    }  # fmt: skip


def noise(scenario: Scenario) -> float:
    """Gain of the sensor's shot noise."""
    exposure = scenario.optics.exposure
    assert isinstance(exposure, FixedExposure)
    return max(2.0**exposure.exposure_ev, 1.0) / scenario.optics.sensor.full_well_e


def balanced(scenario: Scenario) -> tuple[float, float]:
    """Say by what the white balance multiplies gain and read variance of a grey surface's luminance."""
    if scenario.optics.night_mode == "on":  # grey images have none
        return 1.0, 1.0
    share, gains = np.square(BT709) / np.square(BT709).sum(), np.array(scenario.optics.white_balance)
    return float(share @ gains), float(share @ gains**2)


def without_noise(scenario: Scenario) -> Scenario:
    """Give a scenario a sensor without noise."""
    sensor = replace(scenario.optics.sensor, full_well_e=1e6, read_noise_e=0.0, fixed_pattern_percent=0.0)
    return replace(scenario, optics=replace(scenario.optics, sensor=sensor))


def overshoot(video: Video, path: Path, footage: Footage, hidden: NDArray[np.bool_]) -> float | None:
    """Measure how far edges overshoot without noise and coding, %: what is measured depends on how soft edges are."""
    step = clean_step(footage.frames)
    clean: Iterable[NDArray[np.uint8]]
    if video.foreign:
        clean = (pictures.read(clean_file(path, frame)) for frame in range(0, footage.frames, step))
    else:
        made = simgrab.frames(without_noise(video.scenario), buffers=False)
        clean = (frame.rgb for i, frame in enumerate(made) if i % step == 0)
    luma = [np.rint(rgb @ np.array(footage.weights)).astype(np.uint8) for rgb in clean]
    return sharpness(dataclasses.replace(footage, luma=np.stack(luma)), hidden).overshoot.value


def compared(video: Video, path: Path, seen: Appearance) -> dict[str, Any]:
    """Compare what was measured with its scene."""
    scenario, footage = video.scenario, seen.footage
    known = truths(scenario)
    if seen.sharpness.overshoot.value is not None:
        known["overshoot"] = overshoot(video, path, footage, seen.display.mask(*footage.luma.shape[1:]))
    found: dict[str, Quantity] = {
        "noise gain": seen.noise.gain, "read noise": seen.noise.read, "blur": seen.blur.diameter,
        "vignetting": seen.vignetting, "overshoot": seen.sharpness.overshoot,
    }  # fmt: skip
    if not video.foreign:  # whose paint has another hue, by other light
        found["hue"] = seen.grab.hue_deg
    stated = {
        "width": footage.size[0], "height": footage.size[1], "frame rate": footage.frame_rate_hz,
        "key frames": footage.gop_frames, "grey": float(seen.grey),
    }  # fmt: skip
    row: dict[str, Any] = {
        "video": video.number, "foreign": video.foreign, "intervals": {},
        "stated": {name: [value, known[name]] for name, value in stated.items()},
        "place": type(scenario.place).__name__, "night": scenario.light.floodlights > 0,
        "fog": scenario.weather.visibility_m, "rain": scenario.weather.rain_mm_h, "snow": scenario.weather.snow_mm_h,
        "quantiser": footage.quantiser, "still": seen.still, "reasons": {},
    }  # fmt: skip
    for name, quantity in found.items():
        truth = known[name]
        if quantity.value is None:
            row["reasons"][name] = quantity.reason
        elif name != "overshoot" or truth is not None:
            if name == "hue" and truth is not None:  # hues go round
                truth += 360 * round((quantity.value - truth) / 360)
            row["intervals"][name] = [quantity.value, quantity.low, quantity.high, truth]
    if seen.noise.gain.value is not None:  # of the sensor that the matched scene gets, and of the true one
        row["sensor"] = [seen.noise.gain.value / seen.sharpness.noise_gain, balanced(scenario)[0] * noise(scenario)]
    layout, own = seen.display.layout, scenario.display_layout
    if seen.sharpness.overshoot.value is not None:
        row["sharpened"] = [scenario.optics.sharpening.amount > 0, seen.sharpness.amount > 0]
    row["display"] = [own is not None, layout is not None, own is not None and layout is not None and near(layout, own)]
    return row


def near(found: Layout, own: Layout) -> bool:
    """Whether the middles of all cells lie within a third of a digit of the true ones."""
    middles = [np.array([((x0 + x1) / 2, (y0 + y1) / 2) for x0, y0, x1, y1 in layout.cells]) for layout in (found, own)]
    return bool(np.abs(middles[0] - middles[1]).max() <= own.digit_width_px / 3)


def tables(rows: list[dict[str, Any]]) -> str:
    """Write the results as Markdown."""
    lines = ["| | determined | interval holds | median error | largest error |", "|---|---|---|---|---|"]
    held = of = 0
    for name, unit in (
        ("noise gain", "%"),
        ("read noise", "%"),
        ("blur", " px"),
        ("vignetting", " stops"),
        ("overshoot", " points"),
        ("hue", "°"),
    ):
        some = np.array([row["intervals"][name] for row in rows if name in row["intervals"]], float).reshape(-1, 4)
        inside = (some[:, 1] <= some[:, 3] + 1e-9) & (some[:, 3] <= some[:, 2] + 1e-9)
        error = np.abs(some[:, 0] - some[:, 3])
        if unit == "%":
            error = 100 * error[some[:, 3] > 0] / some[some[:, 3] > 0, 3]
        held, of = held + int(inside.sum()), of + len(some)
        share = f"{inside.sum()} of {len(some)}"
        middle = f"{np.median(error):.2g}{unit} | {error.max():.2g}{unit}" if len(error) else "– | –"
        lines.append(f"| {name} | {len(some)} of {len(rows)} | {share} | {middle} |")
    low, high = clopper_pearson(held, of) or (0.0, 1.0)
    lines.append(f"| all | | {held} of {of}: {held / max(of, 1):.1%} ({low:.1%} to {high:.1%}) | | |")
    lines += ["", "| | right |", "|---|---|"]
    for name in rows[0]["stated"] if rows else ():
        pairs = [row["stated"][name] for row in rows if row["stated"][name][0] is not None]
        right = sum(abs(a - b) <= 1e-3 * abs(b) for a, b in pairs)
        lines.append(f"| {name} | {right} of {len(pairs)} |")
    written = np.array([row["sensor"] for row in rows if "sensor" in row], float).reshape(-1, 2)
    if len(written):
        off = 100 * np.abs(written[:, 0] / written[:, 1] - 1)
        lines.append(f"| sensor's noise gain, as the scene gets it | median error {np.median(off):.2g} % |")
    shown = [row["display"] for row in rows]
    sharpened = [row["sharpened"] for row in rows if "sharpened" in row]
    counts = (
        ("display found where there is one", [d[1] for d in shown if d[0]]),
        ("its digits in the right place", [d[2] for d in shown if d[0] and d[1]]),
        ("no display found where there is none", [not d[1] for d in shown if not d[0]]),
        ("sharpening found where there is some", [s[1] for s in sharpened if s[0]]),
        ("no sharpening found where there is none", [not s[1] for s in sharpened if not s[0]]),
    )
    lines += [f"| {name} | {sum(right)} of {len(right)} |" for name, right in counts]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
