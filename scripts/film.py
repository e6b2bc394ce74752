"""Make the README's film: a swing with its labels, in other weathers, and as the bundled instrument measures it.

python -m scripts.film [--out docs/film.webp]

Its 30 s are `alarm-cycles` from 89 s on, in real time: the grab is hoisted, slewed and braked too hard.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

import simgrab
from simgrab.dataset import preview
from simgrab.dataset.tables import calibration_of
from simgrab.instrument.contract import Frame as Picture
from simgrab.instrument.pipeline import bundled
from simgrab.instrument.run.run import measure
from simgrab.instrument.run.video import annotate
from simgrab.model.scenario import Scenario
from simgrab.model.truth import Row

SCENE, SIZE, WIDTH = "alarm-cycles", (960, 540), 640
START, LABELLED, WEATHERED, MEASURED, END = 800, 845, 900, 972, 1070
WEATHERS = ("rain", "fog", "heavy-snow", "night-light-snow")
LOOK = ("light", "optics", "shutter", "weather")  # what the bundled weathers change of a picture
QUALITY = 34


def weathered(name: str) -> Scenario:
    """Give the film's scene in the weather of a bundled one; the swing stays."""
    look = simgrab.load(name).to_dict()
    if look["optics"]["exposure"]["model"] == "auto":
        look["optics"]["exposure"]["lag_s"] = 0.0  # else each part meters all frames from the clip's beginning
    return simgrab.load(SCENE, {key: look[key] for key in LOOK}, size=SIZE)


def film() -> Iterator[NDArray[np.uint8]]:
    """Make the pictures, BGR, one after another."""
    scene = simgrab.load(SCENE, size=SIZE)
    frames = list(simgrab.frames(scene, range(START, END), buffers=False))
    for frame in frames[: LABELLED - START]:
        yield captioned(frame.rgb[..., ::-1], "Rendered: the grab swings by a known angle")
    for frame in frames[LABELLED - START : WEATHERED - START]:
        row = Row(**msgspec.structs.asdict(frame.truth), split="", file="", image_sha256="")
        labelled = preview.annotate(frame.rgb[..., ::-1], row)[: WIDTH * SIZE[1] // SIZE[0]]
        yield captioned(labelled, f"Exact labels: the true swing is {row.alpha_deg:.2f} deg")
    each = (MEASURED - WEATHERED) // len(WEATHERS)
    for number, name in enumerate(WEATHERS):
        first = WEATHERED + number * each
        for frame in simgrab.frames(weathered(name), range(first, first + each), buffers=False):
            yield captioned(frame.rgb[..., ::-1], f"The same swing in other weather: {name}")
    rate = scene.clip.frame_rate_hz
    pictures = [Picture(frame.rgb, number / rate) for number, frame in enumerate(frames)]
    found = measure(pictures, calibration_of(scene), bundled())
    for frame, measured in list(zip(frames, found.measurements, strict=True))[MEASURED - START :]:
        drawn = annotate(frame.rgb, measured)[..., ::-1]
        yield captioned(drawn, f"Measured from the pictures alone; the true swing is {frame.truth.alpha_deg:.2f} deg")


def captioned(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """Reduce a picture (BGR), and put a line of text below it."""
    scale = WIDTH / picture.shape[1]
    return preview.captioned(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), text)


def main() -> None:
    """Parse, render and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "film.webp")
    chosen = parser.parse_args()
    animation = cv2.Animation()
    animation.frames = list(film())
    animation.durations = [round(1000 / simgrab.load(SCENE).clip.frame_rate_hz)] * len(animation.frames)
    cv2.imwriteanimation(str(chosen.out), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    print(f"{chosen.out}: {len(animation.frames)} pictures, {chosen.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
