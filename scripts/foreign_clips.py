"""Measure swing in clips by MuJoCo and by Blender: ``python -m scripts.foreign_clips --blender PYTHON``.

PYTHON is an interpreter that can import bpy, as `scripts.foreign_exam` takes it. Without it the clips are scored, as
far as they are there. Each clip is one world: working cycles of the default grab by day, at dusk and at night, over a
level yard, seen by a fixed camera. simgrab labels it and renders it with MuJoCo. Blender path-traces the same moments
with materials, ground, light, sensor, coder and digits replaced, as the exam's condition "all" does. The camera is the
same over a clip; only its noise differs from frame to frame. Both videos are measured as ``simgrab run`` does.

Whatever is made stays in the folder, and the same command goes on where it was interrupted, frame by frame.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
from numpy.typing import NDArray

from scripts.foreign import clip_scores
from scripts.foreign.clips import CLIPS, DEFAULT, REPLACEABLE, Filmer, Setting, blender
from simgrab.cli import main as run
from simgrab.errors import RendererError
from simgrab.io.files import write
from simgrab.model import scenes


def _replaced(_context: click.Context, _parameter: click.Parameter, value: str) -> tuple[str, ...]:
    names = {part.strip() for part in value.split(",") if part.strip()}
    unknown = sorted(names - set(REPLACEABLE))
    if unknown:
        raise click.BadParameter(f"{', '.join(unknown)}: of {', '.join(REPLACEABLE)}")
    return tuple(name for name in REPLACEABLE if name in names)


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--blender", "python", metavar="PYTHON", help="Interpreter that can import bpy; without it, only score.")
@click.option("--only", multiple=True, type=click.Choice([clip.time for clip in CLIPS]), help="[default: all]")
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(0.5, 3600), help="Of each clip.")
@click.option("--rate", default=2.0, show_default=True, type=click.FloatRange(0.01, 120), help="Frames a second.")
@click.option("--size", default="960x540", show_default=True)
@click.option("--samples", default=4, show_default=True, help="Of the path tracer, a pixel; it denoises.")
@click.option("--threads", default=1, show_default=True, help="Of the path tracer.")
@click.option("--replaced", default=",".join(DEFAULT), show_default=True, callback=_replaced, help="And grab.")
@click.option("--detector", default="bundled", show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/foreign-clips"), show_default=True)
def main(
    python: str | None, only: tuple[str, ...], seconds: float, rate: float, size: str, samples: int, threads: int,
    replaced: tuple[str, ...], detector: str, out: Path,
) -> None:  # fmt: skip
    """Make the clips, measure them, and write a table, figures and a contact sheet."""
    setting = Setting(scenes.parse_size(size), seconds, rate, samples, replaced)
    stated, path = msgspec.json.decode(msgspec.json.encode(setting)), out / "setting.json"
    if path.exists() and json.loads(path.read_text()) != stated:
        raise click.UsageError(f"{out} holds clips of {json.loads(path.read_text())}; choose another --out")
    write(path, json.dumps(stated) + "\n")
    clips = [clip for clip in CLIPS if not only or clip.time in only]
    refused = {}
    if python:
        filmer = Filmer(out, setting, threads, blender(python), lambda line: click.echo(line, err=True))
        for clip in clips:
            try:
                filmer.film(clip)
            except RendererError as problem:  # the others are made all the same
                refused[clip.time] = str(problem)
    found, strips = dict[str, Any](), list[NDArray[np.uint8]]()
    for clip in clips:
        found[clip.time], shown = clip_scores.measure(out, clip, setting, detector)
        strips += shown
    scores = stated | {"detector": detector, "refused": refused, "clips": found}
    write(out / "scores.json", json.dumps(scores, indent=1) + "\n")
    write(out / "scores.md", clip_scores.table(found))
    if strips:
        write(out / "sheet.jpg", clip_scores.sheet(strips))
    click.echo(clip_scores.table(found))
    for name, why in refused.items():
        click.echo(f"{name} is not complete: {why}", err=True)


if __name__ == "__main__":
    run(main)
