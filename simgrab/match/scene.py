"""From what footage shows of a camera to a scene that is rendered alike, and a page that shows both."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w

from simgrab.dataset.video.render import render_video
from simgrab.errors import ScenarioError, SourceError
from simgrab.instrument.detect import Detector
from simgrab.io.files import write
from simgrab.io.pictures import encode
from simgrab.match.footage import Appearance, Quantity, measure, read
from simgrab.match.footage.footage import to_linear
from simgrab.model import scenes
from simgrab.model.calibration import Calibration
from simgrab.model.distributions import Uniform
from simgrab.model.geometry import PAPER_FOCAL_LENGTH_MM, PAPER_PIXELS_PER_MM
from simgrab.model.scenario import Factor, OneOf, Scenario
from simgrab.model.srgb import decoded, encoded
from simgrab.reports import html
from simgrab.reports.plots import Figure
from simgrab.text import printable
from simgrab.world.frames import frames

BASE, TRAINED_ON = "quay-day", "training"
SECONDS = 10.0
SHOWN_FRAMES = 24
"""Of ours, to compare with theirs."""
SIDES_PX = (64, 4096)
SCENE, TRAINING, CAMERA, PAGE = "matched.toml", "training.toml", "camera.toml", "match.html"
TRAINING_FRAMES = 960
NIGHT = {"sun": 0.0, "sky": 0.012, "floodlights": 0.06}  # as in `training`
MOST_BLUR_PX = 50.0
LEVEL_SPREAD = 1.25  # by which the exposure of training frames varies about what was measured
CAST_SPREAD = 1.1  # likewise the gains of red and blue: the surroundings have colours of their own
MOST_GAIN = 4.0  # of a colour


@dataclass(frozen=True, eq=False)
class Matched:
    """A matched scene."""

    theirs: Appearance  # of the user's footage
    scene: str  # the scene's file
    training: str  # the file of a scene to train on
    ours: Appearance | None  # of a video rendered by the scene; None where it was not wanted

    def save(self, folder: Path) -> None:
        """Write scenes, camera file and page into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        write(folder / CAMERA, camera_of(self.theirs))
        write(folder / SCENE, self.scene)
        write(folder / TRAINING, self.training)
        if self.ours is not None:
            write(folder / PAGE, page(self))


def match(
    videos: Sequence[str | Path],
    detector: Detector,
    *,
    night: bool = False,
    compare: bool = True,
    report: Callable[[str], None] = lambda _: None,
) -> Matched:
    """Measure a camera's footage, and write a scene whose frames look alike.

    Parameters
    ----------
    videos : sequence of str or Path
        Of one camera; each quantity is that of the video that determines it best.
    night : bool
        Whether they were recorded by floodlights.
    compare : bool
        Whether to render the scene, and to measure it in the same way.
    report : callable
        Called with a line at the beginning of each step.

    Raises
    ------
    SourceError
        If a video cannot be read, or they differ in size.
    """
    parts = []
    for video in videos:
        report(f"measuring {Path(video).name}")
        parts.append(measure(read(video), detector, night=night))
    seen = together(parts)
    report("making scenes that match")
    scenario, text = scene_of(seen, night=night)
    training = training_scene(seen, scenario)
    if not compare:
        return Matched(seen, text, training, None)
    few = msgspec.structs.replace(scenario, frames=min(scenario.frames, SHOWN_FRAMES))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ours.mp4"
        report(f"rendering {few.frames} frames, to compare (--no-compare leaves this out)")
        render_video(few, path)
        report("measuring them")
        return Matched(seen, text, training, measure(read(path), detector, night=night))


def together(parts: Sequence[Appearance]) -> Appearance:
    """Take each quantity from the video that determines it best."""
    first = parts[0]
    for other in parts[1:]:
        if other.footage.size != first.footage.size:
            sizes = "{}x{} px, and {} of {}x{} px".format(*other.footage.size, first.footage.name, *first.footage.size)
            raise SourceError(f"{other.footage.name}: is of {sizes}: match each alone")
    bright = [one for one in parts if not one.dark] or list(parts)

    def best(of: Callable[[Appearance], Quantity]) -> Appearance:
        return min(bright, key=lambda one: of(one).high - of(one).low if of(one).known else math.inf)

    noisy = best(lambda one: one.noise.gain)
    return replace(
        best(lambda one: one.level),
        noise=noisy.noise,
        blur=best(lambda one: one.blur).blur,
        sharpness=best(lambda one: one.sharpness.overshoot).sharpness,
        vignetting=best(lambda one: one.vignetting).vignetting,
        display=max(bright, key=lambda one: one.display.read).display,
        grab=best(lambda one: one.grab.size_px).grab,
    )


def scene_of(appearance: Appearance, *, night: bool = False) -> tuple[Scenario, str]:
    """Write the scene that matches footage: the scenario, and its file with what is not determined as comments."""
    width, height = _size(appearance)
    optics: dict[str, Any] = {}
    if appearance.vignetting.value is not None:
        optics["vignetting_stops"] = _rounded(min(appearance.vignetting.value, 8.0))
    if appearance.blur.value is not None:
        optics["defocus_px"] = _rounded(min(appearance.blur.value, MOST_BLUR_PX))
    if appearance.footage.grey:
        optics["night_mode"] = "on"
    if amount := appearance.sharpness.amount:
        optics["sharpening"] = {"amount": _rounded(amount), "radius_px": appearance.sharpness.radius_px}
    clip = _clip(appearance)
    data: dict[str, Any] = {
        "name": "matched",
        "frames": max(math.ceil(SECONDS * clip.get("frame_rate_hz", 9.0)), 1),
        "camera": {
            "width_px": width,
            "height_px": height,
            "focal": {"model": "pixels", "focal_length_px": _focal_length_px(width, height)},
        },
        "swing": {"model": "dynamic"},
        "clip": clip,
        "optics": optics,
        "image": {"format": "png"},
    }
    if night:
        data["light"] = NIGHT
    if appearance.display.layout is not None:
        data["display"] = {"layout": msgspec.to_builtins(appearance.display.layout)}
    stops = 0.0
    if appearance.level.value is not None:
        stops, gains = _exposure(data, appearance)
        if gains:
            optics["white_balance"] = gains
        optics["exposure"] = {"model": "fixed", "exposure_ev": _rounded(stops)}
        optics |= _sensor(appearance, max(2.0**stops, 1.0))
    if appearance.grab.paint_rgb is not None:
        data["grab"] = {"paint_rgb": [_rounded(channel) for channel in _paint(appearance.grab.paint_rgb, stops)]}
    return scenes.load(BASE, data), _comments(appearance, "is that of the paper's camera", BASE) + tomli_w.dumps(
        {"base": BASE} | data
    )


def camera_of(appearance: Appearance) -> str:
    """Write the camera TOML for `simgrab run`, in which everything but size and display is assumed."""
    (width, height), display = appearance.footage.size, appearance.display
    constant = ("display_constant_m",) if display.layout else ()
    assumed = ("focal_length_px", "cx_px", "cy_px", "k1", "offset_m", "roll_deg", *constant)
    camera = Calibration(
        width, height, _focal_length_px(width, height), width / 2, height / 2, digit_layout=display.layout,
        assumed=assumed,
    )  # fmt: skip
    notes = {
        "focal_length_px": "not determined by footage: the paper's camera's; 1 % more makes angles up to 1 % smaller",
        "cx_px, cy_px, k1 …": "not determined by footage: the middle of the picture, and no distortion",
        "roll_deg": "not determined by footage: how far the camera is turned about its axis",
        "offset_m": "not determined by footage: camera minus rope exit, outboard, left and up; 0 is at the rope exit",
        "its signs": "ropes leave the picture on the right where the second number is above 0, on the left where it is "
        "below; at the bottom where the first is above 0, at the top where it is below",
        "offset_sd_m": "standard deviation of each number; 0.05 for a tape measure",
        "display_constant_m": "not determined by footage: rope exit to grab centre, minus the length displayed",
        "digit_layout": "as read" if display.layout else f"not determined by this footage: {display.reason}",
        "assumed": "remove a key once you have stated your own value",
    }
    lines = (f"{key}: {note}." for key, note in notes.items())
    return _commented(f"Camera of {appearance.footage.name}, for simgrab run.", *lines) + camera.to_toml()


def training_scene(appearance: Appearance, matched: Scenario) -> str:
    """Write the scene `training` as the camera shows it: what was measured varies within its interval only.

    Everything is written out, because a file cannot take back what its base lets vary.
    """
    changes: dict[str, Any] = {"name": "matched-training", "frames": TRAINING_FRAMES}
    drawn = dict[str, tuple[float, float]]()
    if appearance.vignetting.known:
        drawn["optics.vignetting_stops"] = (min(appearance.vignetting.low, 8.0), min(appearance.vignetting.high, 8.0))
    if appearance.blur.known:
        drawn["optics.defocus_px"] = (max(appearance.blur.low, 0.0), min(appearance.blur.high, MOST_BLUR_PX))
    if appearance.level.value:
        low, high = appearance.level.value / LEVEL_SPREAD, appearance.level.value * LEVEL_SPREAD
        drawn["optics.exposure.target_level"] = (min(max(low, 0.01), 0.7), min(max(high, 0.012), 0.9))
        changes["optics.exposure.exposure_ev"] = 0.0
    for name, value in _sensor(appearance, 1.0).get("sensor", {}).items():
        changes[f"optics.sensor.{name}"] = value
    if appearance.footage.grey:
        changes["optics.night_mode"] = "on"
    if not matched.light.sun:
        changes["light"] = NIGHT
    if appearance.display.layout is not None:
        changes["display.layout"] = msgspec.to_builtins(appearance.display.layout)
    changes |= {key: _rounded(low) for key, (low, _) in drawn.items()}
    straight = {"camera.distortion.k1": 0.0}  # small or upright pictures allow neither the lens nor the display
    for left_out in ({}, straight, straight | {"display.layout": "none"}):
        try:
            scene = scenes.load(TRAINED_ON, left_out | changes, size=_size(appearance))
            break
        except ScenarioError as problem:
            refused = problem
    else:
        raise refused
    measured: dict[str, Factor] = {
        key: Uniform(_rounded(low), _rounded(high)) for key, (low, high) in drawn.items() if low < high
    }
    if appearance.grab.paint_rgb is not None:
        measured["grab.paint_rgb"] = OneOf((matched.grab.paint_rgb,))
    red, green, blue = matched.optics.white_balance
    if not appearance.footage.grey and (red, green, blue) != (1.0, 1.0, 1.0):
        spread = (1 / CAST_SPREAD, 1.0, CAST_SPREAD)
        casts = tuple((_rounded(red * r), green, _rounded(blue * b)) for r in spread for b in spread)
        measured["optics.white_balance"] = OneOf(casts)
    optics = msgspec.structs.replace(scene.optics, sharpening=matched.optics.sharpening)  # in px of this size
    scene = msgspec.structs.replace(scene, vary=scene.vary | measured, optics=optics)
    return _comments(appearance, "varies", TRAINED_ON) + scene.to_toml()


def _size(seen: Appearance) -> tuple[int, int]:
    """Width and height that can be rendered, px."""
    width, height = (min(max(side - side % 2, SIDES_PX[0]), SIDES_PX[1]) for side in seen.footage.size)
    return width, height


def _clip(seen: Appearance) -> dict[str, Any]:
    footage, clip = seen.footage, dict[str, Any]()
    if footage.frame_rate_hz is not None:
        clip["frame_rate_hz"] = _rounded(min(max(footage.frame_rate_hz, 0.01), 120.0))
    if footage.bit_rate_mbit_s:
        clip["bit_rate_mbit_s"] = _rounded(min(max(footage.bit_rate_mbit_s, 0.01), 200.0))
    if footage.gop_frames:
        clip["gop_frames"] = min(max(footage.gop_frames, 1), 1000)
    return clip


def _sensor(seen: Appearance, gain: float) -> dict[str, Any]:
    """Give the sensor whose noise is what was measured, at a gain of the exposure and before any sharpening."""
    shot, read_noise = seen.noise.gain.value, seen.noise.read.value
    if not shot:
        return {}
    shot, read_noise = shot / seen.sharpness.noise_gain, (read_noise or 0.0) / math.sqrt(seen.sharpness.noise_gain)
    well = min(max(gain / shot, 100.0), 1e6)
    noise = min(read_noise * well / gain, 1000.0)
    return {"sensor": {"full_well_e": _rounded(well), "read_noise_e": _rounded(noise)}}


def _exposure(data: dict[str, Any], seen: Appearance) -> tuple[float, list[float]]:
    """Find the stops and the gains of red, green and blue by which the scene's frames get a mean level and colour.

    Without a colour in the footage there are no gains.
    """
    (frame,) = frames(scenes.load(BASE, data | {"display.layout": "none"}), (0,), buffers=False)
    light = to_linear(frame.rgb[::2, ::2])
    gains = list[float]()
    if seen.cast[0].value and seen.cast[1].value:
        ours = light.mean(axis=(0, 1))
        wanted = (seen.cast[0].value * ours[1] / ours[0], 1.0, seen.cast[1].value * ours[1] / ours[2])
        gains = [_rounded(float(np.clip(gain, 1 / MOST_GAIN, MOST_GAIN))) for gain in wanted]
        light = light * gains
    luminance = light @ (0.2126, 0.7152, 0.0722)

    def off(stops: float) -> float:
        return float(np.minimum(luminance * 2.0**stops, 1.0).mean()) - float(seen.level.value or 0.0)

    low, high = -8.0, 8.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if off(middle) < 0 else (low, middle)
    return (low + high) / 2, gains


def _paint(shown: Sequence[float], stops: float) -> list[float]:
    """Undo an exposure: the colour, 0 to 1, that paint has in a picture of a usual exposure."""
    light = decoded(np.asarray(shown, float)) / 2.0**stops
    return encoded(light / max(float(light.max()), 1.0)).tolist()


def _focal_length_px(width: int, height: int) -> float:
    """Focal length of the paper's camera for pictures of a size."""
    return _rounded(PAPER_FOCAL_LENGTH_MM * PAPER_PIXELS_PER_MM * max(width, height) / 1920)


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _comments(seen: Appearance, focal: str, base: str) -> str:
    """Say where each value is from; a comment has one line, whatever the video is called."""
    lines = [f"Matched to {seen.footage.name}. 95 % intervals:"]
    lines += [f"{name}: {text}" for name, text in seen.rows()]
    lines.append(f"The focal length {focal}: footage alone does not determine it.")
    return _commented(*lines, f"What was not measured is as in {base}.")


def _commented(*lines: str) -> str:
    return "".join(f"# {printable(line)}\n" for line in lines) + "\n"


def page(matched: Matched) -> str:
    """Write the page: theirs and ours side by side, with histograms, spectra and noise curves."""
    theirs, ours = matched.theirs, matched.ours
    assert ours is not None
    rows = [(name, text, own) for (name, text), (_, own) in zip(theirs.rows(), ours.rows(), strict=True)]
    return html.page(
        "match.html", name=theirs.footage.name, rows=rows,
        theirs=encode(theirs.footage.rgb[0][..., ::-1], "jpeg", 90),
        ours=encode(ours.footage.rgb[0][..., ::-1], "jpeg", 90),
        figures=_figures(theirs, ours), scene=matched.scene,
    )  # fmt: skip


def _figures(theirs: Appearance, ours: Appearance) -> list[tuple[str, Figure]]:
    labels = {
        "Histogram of one frame": ("luma, levels", "share of the pixels"),
        "Spectrum of one frame": ("frequency, cycles a pixel", "power, levels²"),
        "Noise": ("luma, levels", "noise, standard deviation, levels"),
    }
    figures = {title: Figure((5, 3)) for title in labels}
    histogram, spectrum, curve = (figures[title].add_subplot(xlabel=x, ylabel=y) for title, (x, y) in labels.items())
    for name, one, colour in (("theirs", theirs, "tab:blue"), ("ours", ours, "tab:orange")):
        luma = one.footage.luma[0]
        counts = np.bincount(luma.ravel(), minlength=256) / luma.size
        histogram.step(np.arange(256), counts, label=name, color=colour, where="mid")
        spectrum.loglog(*_spectrum(luma), label=name, color=colour)
        if one.noise.curve is not None:
            level, variance = one.noise.curve
            curve.plot(level, np.sqrt(variance), "o-", label=name, color=colour)
    for axes in (histogram, spectrum, curve):
        if axes.get_legend_handles_labels()[0]:
            axes.legend()
    for figure in figures.values():
        figure.tight_layout()
    return list(figures.items())


def _spectrum(luma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radial mean of the power spectrum of a picture's middle."""
    side = min(luma.shape)
    y, x = (luma.shape[0] - side) // 2, (luma.shape[1] - side) // 2
    part = luma[y : y + side, x : x + side].astype(float)
    window = np.hanning(side)
    power = np.abs(np.fft.fft2((part - part.mean()) * window * window[:, None])) ** 2 / side**2
    f = np.fft.fftfreq(side)
    radius = np.hypot(f, f[:, None])
    which = np.digitize(radius.ravel(), edges := np.linspace(0, 0.5, 60))
    total, count = np.bincount(which, power.ravel(), 61), np.bincount(which, minlength=61)
    return (edges[1:] + edges[:-1]) / 2, (total[1:60] / np.maximum(count[1:60], 1))
