"""``simgrab render``."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simgrab.cli._options import AUTO_WORKERS, FILE, FOLDER_OR_URL, cluster_option
from simgrab.cli._progress import drawing
from simgrab.cli._resume import resumable
from simgrab.cli._scene import extension_options, load_scene, scene_options
from simgrab.io.stores import is_url
from simgrab.text import printable

if TYPE_CHECKING:
    from simgrab.dataset.price import Price
    from simgrab.model.scenario import Scenario

_LABELS = {"fingerprint": "renderer SHA-256"}


@click.command(name="render")
@scene_options
@click.option(
    "--out", type=FOLDER_OR_URL, help="Folder of the dataset, or URL of a dataset of shards.  [default: runs/SCENE]"
)
@click.option(
    "--yolo",
    type=click.Choice(("box", "pose", "seg", "obb")),
    help="YOLO labels: boxes, key points, polygons or oriented boxes.  [default: box]",
)
@click.option("--video", type=FILE, help="Write a video (.mp4, .mkv); add --out for a dataset too.")
@click.option("--workers", type=AUTO_WORKERS, default="auto", show_default=True, help="Worker processes, or auto.")
@cluster_option
@click.option("--shard-frames", type=click.IntRange(1), help="Frames of a shard.  [default: 256]")
@click.option("--resume", is_flag=True, help="Continue an unfinished dataset, or a video at its unfinished clip.")
@extension_options
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option("--quiet", is_flag=True, help="Print errors only.")
def command(
    scene: str, beta: float | None, sigma: float | None, frames: int | None, seed: int | None, size: str | None,
    assignments: tuple[str, ...], out: Path | str | None, yolo: str | None, video: Path | None, workers: int | None,
    cluster: str | None, shard_frames: int | None, resume: bool, randomiser: str | None, trajectory: str | None,
    effects: tuple[str, ...], as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Render SCENE (a bundled scene, a TOML file or a dataset's manifest.json) as a dataset of labelled frames.

    With --video, write a video and its truth table instead; with --out as well, write both. With a URL as --out
    (s3://bucket/name, file:///data/name), write a dataset of shards: WebDataset archives with labels as Parquet.
    """
    scenario = load_scene(scene, assignments, size, beta=beta, sigma=sigma, frames=frames, seed=seed, yolo=yolo)
    if video is None:
        out = out or Path("runs") / scenario.name
    from simgrab.dataset.notices import notices
    from simgrab.dataset.pool import automatic
    from simgrab.dataset.price import FEW
    from simgrab.dataset.render import render
    from simgrab.dataset.shards import frames_of
    from simgrab.dataset.summary import Summary, VideoSummary, doubts
    from simgrab.dataset.video.render import render_video
    from simgrab.dataset.yolo import straightened
    from simgrab.judge.own_grab import remarks
    from simgrab.model.scenario import Iid
    from simgrab.reports.terminal import stdout, table
    from simgrab.world.extensions import Extensions, Recipe

    given = Extensions.of(randomiser, trajectory, effects)
    given.refuse_others(scene)
    recipe = Recipe(scenario, given)
    for line in () if quiet else remarks(scenario.grab):
        click.echo(printable(f"grab.file: {line}"), err=True)
    if cluster is not None and workers is not None:
        raise click.UsageError("--cluster replaces --workers: give only one of them")
    if cluster is not None:
        workers, how = 1, f"rendered by the cluster at {cluster}"
    elif workers is None:
        each = frames_of(scenario, shard_frames, varies=recipe.varies) if is_url(out) else None
        workers, limit = automatic(recipe, by_clip=video is not None, shard_frames=each)
        how = f"worker processes: {workers} (limited by {limit})"
    else:
        how = f"worker processes: {workers}"
    if video is not None and isinstance(scenario.swing, Iid) and given.trajectory is None and not quiet:
        click.echo(
            f'{scenario.name} draws each frame on its own (swing.model = "iid"): in a video, rope and grab jump from '
            "frame to frame; work-cycles and free-swing move",
            err=True,
        )
    for line in () if quiet else notices(recipe, splits=out is not None):
        click.echo(line, err=True)
    functions: Any = {"randomiser": given.randomiser, "trajectory": given.trajectory, "effects": given.effects}
    summary: Summary | VideoSummary
    places = [path for path in (out, video) if path is not None]
    if resume and not quiet and not any(is_url(place) or Path(place).exists() for place in places):
        click.echo(printable(f"--resume: nothing is begun in {' or '.join(map(str, places))}; begins there"), err=True)
    again = "" if video is None else "; an unfinished clip of a video begins again"
    with resumable(*places, but=again), drawing(shown=not (quiet or as_json)) as (progress, checking):
        priced = None if quiet or as_json or cluster or resume or scenario.frames < FEW else _print_price
        if priced:
            click.echo("estimating time and size, from a few frames", err=True)
        if out is not None:
            summary = render(
                scenario, out, video=video, workers=workers, cluster=cluster, shard_frames=shard_frames,
                resume=resume, progress=progress, checking=checking, priced=priced, **functions,
            )  # fmt: skip
        else:
            if cluster is not None:
                raise click.UsageError("--cluster renders datasets, not videos")
            assert video is not None
            summary = render_video(
                scenario, video, workers=workers, resume=resume, progress=progress, checking=checking, priced=priced,
                **functions,
            )  # fmt: skip
    lines = [] if quiet else doubts(summary)
    if not quiet and scenario.labels.yolo == "obb" and out is not None and not is_url(out):
        lines.append(straightened(Path(out)))
    for line in filter(None, lines):
        click.echo(line, err=True)
    if as_json:
        click.echo(json.dumps(dataclasses.asdict(summary), default=str))
    elif not quiet:
        facts = dataclasses.asdict(summary)
        facts.pop("below_least", None)  # a line states it
        if given == Extensions() and "alpha_rms_deg" in facts:
            facts["alpha_rms_deg"] = _text(facts["alpha_rms_deg"]) + _expected(scenario, summary.frames)
        shown = ((key, value) for key, value in facts.items() if value is not None)
        stdout().print(table((_LABELS.get(key, key.replace("_", " ")), _text(value)) for key, value in shown))
        click.echo(printable(how))
        if out is not None:
            labels = "labels" if is_url(out) else "labels.parquet"
            click.echo(printable(f"preview: {out}/preview.jpg; labels: {out}/{labels}"))
        if video is not None:
            click.echo(printable(f"the truth table of each video of {video} is beside it, as .parquet"))


def _expected(scenario: Scenario, frames: int) -> str:
    """State √E[α²] as it is drawn, and the standard deviation of that of so many frames; empty where they differ."""
    from simgrab.model.distributions import HalfNormal
    from simgrab.model.scenario import Iid

    swing, varied = scenario.swing, "+".join(scenario.vary).split("+")
    if not isinstance(swing, Iid) or not isinstance(swing.alpha.law, HalfNormal):
        return ""
    if any(key == "swing" or key.startswith("swing.alpha") for key in varied):
        return ""
    return f" (sigma {swing.alpha.sigma_deg:g} ± {swing.alpha.sigma_deg / math.sqrt(2 * frames):.2f})"


def _print_price(price: Price) -> None:
    click.echo(f"{price}; Ctrl-C stops, --resume goes on", err=True)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, tuple):
        return " … ".join(dict.fromkeys(_text(v) for v in value))
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return printable(str(value))
