"""``simgrab render``."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from simgrab.cli._options import AUTO_WORKERS, FILE, FOLDER
from simgrab.cli._progress import drawing
from simgrab.cli._resume import resumable
from simgrab.cli._scene import extension_options, load_scene, scene_options
from simgrab.pages.terminal import table
from simgrab.text import printable


@click.command(name="render")
@scene_options
@click.option("--out", type=FOLDER, help="Folder of the dataset.  [default: runs/SCENE, or none]")
@click.option("--video", type=FILE, help="Write a video (.mp4, .mkv); add --out for a dataset too.")
@click.option("--workers", type=AUTO_WORKERS, default="auto", show_default=True, help="Worker processes, or auto.")
@click.option("--resume", is_flag=True, help="Continue an unfinished dataset.")
@extension_options
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option("--quiet", is_flag=True, help="Print errors only.")
def command(
    scene: str, beta: float | None, sigma: float | None, frames: int | None, seed: int | None, size: str | None,
    assignments: tuple[str, ...], out: Path | None, video: Path | None, workers: int | None, resume: bool,
    randomiser: str | None, trajectory: str | None, effects: tuple[str, ...], as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Render SCENE (a bundled scene, a TOML file or a dataset's manifest.json) as a dataset of labelled frames.

    With --video, write a video and its truth table instead; with --out as well, write both.
    """
    scenario = load_scene(scene, assignments, size, beta=beta, sigma=sigma, frames=frames, seed=seed)
    if video is None:
        out = out or Path("runs") / scenario.name
    from simgrab.world.extensions import Extensions, Recipe
    from simgrab.world.output.dataset import Summary, render
    from simgrab.world.output.pool import automatic
    from simgrab.world.output.video.render import VideoSummary, render_video

    given = Extensions.of(randomiser, trajectory, effects)
    given.refuse_others(scene)
    why = ""
    if workers is None:
        workers, limit = automatic(Recipe(scenario, given), by_clip=video is not None)
        why = f" (limited by {limit})"
    functions: Any = {"randomiser": given.randomiser, "trajectory": given.trajectory, "effects": given.effects}
    summary: Summary | VideoSummary
    places = [path for path in (out, video) if path is not None]
    with resumable(*places), drawing(shown=not (quiet or as_json)) as (progress, checking):
        if out is not None:
            summary = render(
                scenario, out, video=video, workers=workers, resume=resume, progress=progress, checking=checking,
                **functions,
            )  # fmt: skip
        else:
            assert video is not None
            summary = render_video(
                scenario, video, workers=workers, resume=resume, progress=progress, checking=checking, **functions
            )
    if as_json:
        click.echo(json.dumps(dataclasses.asdict(summary), default=str))
    elif not quiet:
        facts = dataclasses.asdict(summary).items()
        Console().print(table((key.replace("_", " "), _text(value)) for key, value in facts if value is not None))
        click.echo(f"worker processes: {workers}{why}")
        if out is not None:
            click.echo(printable(f"preview: {out / 'preview.jpg'}; labels: {out / 'labels.parquet'}"))
        if video is not None:
            click.echo(printable(f"the truth table of each video of {video} is beside it, as .parquet"))


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, tuple):
        return " … ".join(_text(v) for v in value)
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return printable(value) if isinstance(value, Path) else str(value)
