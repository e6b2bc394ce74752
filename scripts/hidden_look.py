"""Train on a camera that `simgrab match` measured: ``python -m scripts.hidden_look --out FOLDER``.

A camera's processing that no scene can draw is laid over rendered frames: a colour cast, an odd tone curve, noise, and
strong sharpening after it. ``simgrab match`` gets a video of one place that this camera took, and a detector is
trained on what it writes. Both detectors then look at frames of other places, grabs and weathers by the same camera.

What is made stays in the folder, and the same command goes on where it was interrupted.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from rich.console import Console

import simgrab
from scripts.foreign.camera import film
from scripts.score_detector import WIDTH, boxes_table
from simgrab.cli import main as run
from simgrab.cli._progress import bar
from simgrab.dataset import datasets, preview
from simgrab.dataset.datasets import Dataset
from simgrab.dataset.render import render
from simgrab.instrument.detect import detector as opened
from simgrab.instrument.detect.patches import Picture
from simgrab.io import pictures
from simgrab.io.files import drafted, write
from simgrab.judge.evaluate import detection
from simgrab.judge.evaluate.detection import Case
from simgrab.model import scenes
from simgrab.model.records.observations import Detection
from simgrab.model.rng import stream

SIZE, SECONDS, RATE_HZ, QUALITY = (960, 540), 6, 25.0, 0.6
YARD: dict[str, Any] = {"frames": round(SECONDS * RATE_HZ), "clip.frame_rate_hz": RATE_HZ}
CAST = np.array([1.12, 1.0, 0.72], np.float32)  # of red, green and blue
NOISE_SD = (5.0, 9.0)  # of luminance and of each colour, of 255
SHARPENED, RADIUS_PX = 2.2, 1.6
SHOWN = 12  # frames on the sheet


def taken(rgb: Picture, rng: np.random.Generator) -> Picture:
    """Give a picture, (height, width, 3), the look of the hidden camera."""
    light = np.minimum(rgb.astype(np.float32) / 255 * CAST, 1.0)
    toned = 0.16 + 0.78 * (0.35 * light + 0.65 * np.where(light < 0.5, 2 * light**2, 1 - 2 * (1 - light) ** 2))
    shape = rgb.shape[:2]
    noise = NOISE_SD[0] * rng.standard_normal((*shape, 1), np.float32)
    noise = noise + NOISE_SD[1] * cv2.GaussianBlur(rng.standard_normal((*shape, 3), np.float32), (0, 0), 1.0) * 3
    noisy = 255 * toned.astype(np.float32) + noise
    blurred = cv2.GaussianBlur(noisy, (0, 0), RADIUS_PX)
    return np.clip(np.rint(noisy + SHARPENED * (noisy - blurred)), 0, 255).astype(np.uint8)


def filmed() -> Iterator[Picture]:
    """Show the video that the user of this camera has."""
    for i, frame in enumerate(simgrab.frames(scenes.load("quay-truck", YARD, size=SIZE), buffers=False)):
        yield taken(frame.rgb, stream(1, i, "hidden look"))


def watched(dataset: Dataset, names: tuple[str, ...], sheet: Path) -> dict[str, tuple[list[Case], list[Case]]]:
    """Run detectors on the exam's frames as they are rendered, and as the hidden camera takes them."""
    looks = {name: opened(name) for name in names}
    found = {name: (list[Detection](), list[Detection]()) for name in names}
    shown = list[Any]()
    with bar("exam", shown=True) as progress:
        for i, row in enumerate(dataset.rows):
            rgb = pictures.read(dataset.image(row))
            both = (rgb, taken(rgb, stream(2, i, "hidden look")))
            if i < SHOWN:
                shown.append(cv2.resize(np.vstack(both), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA))
            for name, look in looks.items():
                for detections, picture in zip(found[name], both, strict=True):
                    detections.append(look(picture))
            progress(i + 1, len(dataset.rows))
    write(sheet, pictures.encode(cv2.cvtColor(preview.sheet(shown), cv2.COLOR_RGB2BGR), "jpeg", 90))
    return {
        name: (detection.cases(dataset, plain), detection.cases(dataset, odd)) for name, (plain, odd) in found.items()
    }


def _simgrab(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "simgrab", *map(str, arguments)], check=True)


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--from", "start", default="any-grab", show_default=True, help="Detector that is trained further.")
@click.option("--exam", default="exam-family-known", show_default=True, help="Scene of the other frames.")
@click.option("--quick", is_flag=True, help="Train for a fifth of the time.")
@click.option("--worlds", default=160, show_default=True, type=click.IntRange(2), help="Of the exam, a frame each.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/hidden-look"), show_default=True)
def main(start: str, exam: str, quick: bool, worlds: int, out: Path) -> None:
    """Film, match, train, and compare."""
    out.mkdir(parents=True, exist_ok=True)
    video, matched, own = out / "yard.mp4", out / "matched", out / "own"
    if not video.exists():
        with drafted(video) as draft:
            film(str(draft), "mp4", filmed(), RATE_HZ, "h264", QUALITY)
    if not (matched / "training.toml").exists():
        _simgrab("match", video, "--out", matched, "--no-compare")
    if not (own / "settle.onnx").exists():
        options = ("--from", start, "--scene", matched / "training.toml", "--out", own, *(["--quick"] if quick else []))
        _simgrab("train", "detector", *options, *(["--resume"] if own.exists() else []))
    scene = scenes.load(exam, {"frames": worlds, "clip.clip_frames": 1}, size=SIZE)
    render(scene, out / "exam", workers=2, resume=True)
    found = watched(datasets.read(out / "exam"), (start, str(own)), out / "sheet.jpg")
    groups = {
        f"{name}, {look}": detection.figures(cases[k])
        for name, cases in found.items()
        for k, look in enumerate(("as rendered", "hidden look"))
    }
    write(out / "scores.json", json.dumps(groups, indent=1) + "\n")
    Console(width=WIDTH).print(boxes_table(start, groups))


if __name__ == "__main__":
    run(main)
