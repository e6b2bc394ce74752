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
from pathlib import Path
from typing import Any

import av
import click
import cv2
import numpy as np

import simgrab
from simgrab import scenes
from simgrab.cli import main as run
from simgrab.cli._progress import bar
from simgrab.instrument.detect import detector as opened
from simgrab.instrument.detect.patches import Picture
from simgrab.judge.evaluate import detection
from simgrab.judge.evaluate.detection import Case
from simgrab.labels import datasets
from simgrab.labels.datasets import Dataset
from simgrab.records.observations import Detection
from simgrab.rng import stream
from simgrab.utilities import pictures
from simgrab.utilities.files import drafted, write
from simgrab.world.output.dataset import render

SIZE, SECONDS, RATE_HZ, MBIT_S = (960, 540), 6, 25.0, 16
YARD: dict[str, Any] = {"frames": round(SECONDS * RATE_HZ), "clip.frame_rate_hz": RATE_HZ}
EXAM = "exam-family-known"
CAST = np.array([1.12, 1.0, 0.72], np.float32)  # of red, green and blue
NOISE_SD = (5.0, 9.0)  # of luminance and of each colour, of 255
SHARPENED, RADIUS_PX = 2.2, 1.6
RESAMPLED = 500
FIGURES = ("recall", "map50_95")


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


def film(path: Path) -> None:
    """Write the video that the user of this camera has."""
    scene = scenes.load("quay-truck", YARD, size=SIZE)
    with drafted(path) as draft, av.open(str(draft), "w", format="mp4") as file:
        track: Any = file.add_stream("libx264", rate=int(RATE_HZ), options={"preset": "fast"})
        track.width, track.height, track.pix_fmt, track.bit_rate = *SIZE, "yuv420p", MBIT_S * 1_000_000
        with bar(f"filming {path.name}", shown=True) as progress:
            for i, frame in enumerate(simgrab.frames(scene, buffers=False)):
                rgb = taken(frame.rgb, stream(1, i, "hidden look"))
                file.mux(track.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
                progress(i + 1, scene.frames)
        file.mux(track.encode(None))


def watched(dataset: Dataset, names: tuple[str, ...], sheet: Path) -> dict[str, tuple[list[Case], list[Case]]]:
    """Run detectors on the exam's frames as they are rendered, and as the hidden camera takes them."""
    looks = {name: opened(name) for name in names}
    found = {name: (list[Detection](), list[Detection]()) for name in names}
    shown, worlds = list[Any](), set[int | None]()
    with bar("exam", shown=True) as progress:
        for i, row in enumerate(dataset.rows):
            rgb = pictures.read(dataset.image(row))
            both = (rgb, taken(rgb, stream(2, i, "hidden look")))
            if row.variant not in worlds:
                worlds.add(row.variant)
                shown.append(cv2.resize(np.vstack(both), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA))
            for name, look in looks.items():
                for detections, picture in zip(found[name], both, strict=True):
                    detections.append(look(picture))
            progress(i + 1, len(dataset.rows))
    rows = [np.hstack(shown[k : k + 4]) for k in range(0, min(len(shown), 12) // 4 * 4, 4)]
    if rows:
        write(sheet, cv2.imencode(".jpg", np.vstack(rows)[..., ::-1])[1].tobytes())
    return {
        name: (detection.cases(dataset, plain), detection.cases(dataset, odd)) for name, (plain, odd) in found.items()
    }


def _simgrab(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "simgrab", *map(str, arguments)], check=True)


def gains(before: list[Case], after: list[Case]) -> dict[str, tuple[float, float, float]]:
    """Tell how much more each figure is after, with its 95 % interval by resampling worlds."""
    worlds: dict[Any, list[int]] = {}
    for i, case in enumerate(before):
        worlds.setdefault(case.world, []).append(i)
    drawn = list(worlds.values())
    rng = stream(3, 0, "resampled")
    differences = {name: list[float]() for name in FIGURES}
    for _ in range(RESAMPLED):
        chosen = [i for k in rng.integers(len(drawn), size=len(drawn)) for i in drawn[k]]
        figures = [detection.figures([some[i] for i in chosen]) for some in (before, after)]
        for name in FIGURES:
            differences[name].append(figures[1][name] - figures[0][name])
    whole = [detection.figures(some) for some in (before, after)]
    return {
        name: (whole[1][name] - whole[0][name], *map(float, np.quantile(differences[name], (0.025, 0.975))))
        for name in FIGURES
    }


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--from", "start", default="any-grab", show_default=True, help="Detector that is trained further.")
@click.option("--quick", is_flag=True, help="Train for a fifth of the time.")
@click.option("--worlds", default=48, show_default=True, type=click.IntRange(2), help="Of the exam.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/hidden-look"), show_default=True)
def main(start: str, quick: bool, worlds: int, out: Path) -> None:
    """Film, match, train, and compare."""
    out.mkdir(parents=True, exist_ok=True)
    video, matched, own = out / "yard.mp4", out / "matched", out / "own"
    if not video.exists():
        film(video)
    if not (matched / "training.toml").exists():
        _simgrab("match", video, "--out", matched, "--no-compare")
    if not (own / "settle.onnx").exists():
        options = ("--from", start, "--scene", matched / "training.toml", "--out", own, *(["--quick"] if quick else []))
        _simgrab("train", "detector", *options, *(["--resume"] if own.exists() else []))
    scene = scenes.load(EXAM, {"frames": 5 * worlds, "clip.clip_frames": 5}, size=SIZE)
    render(scene, out / "exam", workers=2, resume=True)
    found = watched(datasets.read(out / "exam"), (start, str(own)), out / "sheet.jpg")
    scores: dict[str, Any] = {
        look: {
            name: {key: detection.figures(cases[k])[key] for key in (*FIGURES, "labelled", "empty", "false_boxes")}
            for name, cases in found.items()
        }
        for k, look in enumerate(("as rendered", "hidden look"))
    }
    for k, look in enumerate(("as rendered", "hidden look")):
        before, after = (cases[k] for cases in found.values())
        scores[look]["gain"] = gains(before, after)
    write(out / "scores.json", json.dumps(scores, indent=1) + "\n")
    click.echo(json.dumps(scores, indent=1))


if __name__ == "__main__":
    run(main)
