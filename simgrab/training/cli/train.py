"""`simgrab train`: nets from datasets; one sub-command for each."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simgrab.cli._options import FOLDER, PATH, together
from simgrab.cli._progress import Board, board, drawing
from simgrab.cli._resume import resumable
from simgrab.text import printable

if TYPE_CHECKING:
    from simgrab.model.scenario import Scenario
    from simgrab.training.loop import TrainingReport


@click.group(name="train")
def command() -> None:
    """Train the instrument's networks from rendered datasets. Needs `pip install 'simgrab[train]'`."""


_seed = functools.partial(click.option, "--seed", type=click.IntRange(0, 2**53), default=0, show_default=True)
_training = together(
    click.option("--device", default="cpu", show_default=True, help="torch device, e.g. cuda."),
    click.option("--resume", is_flag=True, help="Continue an interrupted training."),
    click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON."),
    click.option("--quiet", is_flag=True, help="Print errors only."),
)
_of_detectors = together(
    click.option("--threads", default=2, show_default=True, help="torch threads; use 1 on shared cores."),
    click.option("--half/--no-half", default=None, help="Use bfloat16.  [default: if the hardware supports it]"),
    _training,
)


def follow(board: Board, name: str) -> Callable[[TrainingReport], None]:
    """Begin a training: a bar, and a line for each epoch; gives what takes its reports."""
    task = board.bars.add_task(f"training {name}", total=None, rate="")

    def report(now: TrainingReport) -> None:
        done, total = (now.epoch - 1) * now.steps + now.step, now.epochs * now.steps
        board.bars.update(task, completed=done, total=total, rate=f"{now.examples_per_s:.0f} a second")
        if now.figures:
            figures = "  ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in now.figures.items())
            board.bars.console.print(f"{name} epoch {now.epoch}/{now.epochs}  loss {now.loss:.4f}  {figures}")

    return report


def _print_metrics(metrics: Mapping[str, Any], card: Path, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        click.echo(json.dumps(metrics))
    elif not quiet:
        click.echo(f"{card.read_text(encoding='utf-8')}\nnetworks and cards: {printable(card.parent)}")


def _counts(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[int, ...]:
    """Parse increasing numbers of frames."""
    try:
        counts = tuple(int(part) for part in text.split(",")) if text is not None else ()
    except ValueError:
        raise click.BadParameter("numbers of frames are needed, such as 0,10,30,100") from None
    if any(count < 0 for count in counts) or list(counts) != sorted(set(counts)):
        raise click.BadParameter("the numbers must increase from 0 or more")
    return counts


@command.command()
@click.argument("datasets", nargs=-1, type=PATH)
@click.option("--out", type=FOLDER, required=True, help="New folder for networks, cards, checkpoints.")
@click.option(
    "--grab",
    type=PATH,
    help="Your own grab: a model, or a scene file with it. Frames of it are rendered into OUT-frames.",
)
@click.option("--scene", help="A scene, such as training.toml of `match`. Frames of it are rendered into OUT-frames.")
@click.option(
    "--frames",
    type=click.IntRange(40, 1_000_000),
    help="Frames of --grab or --scene.  [default: 960 of --grab, else the scene's own]",
)
@click.option(
    "--also",
    type=PATH,
    multiple=True,
    help="Real frames in YOLO's or COCO's layout: learned from, and their test videos judged by; may be repeated.",
)
@click.option("--real", type=PATH, multiple=True, help="Real frames that are judged by alone; may be repeated.")
@click.option(
    "--grab-class",
    "grab_classes",
    metavar="NAME",
    multiple=True,
    help="Class of the real frames that is the grab, where there are several; may be repeated.",
)
@click.option(
    "--learning-curve",
    "counts",
    metavar="N,N,…",
    callback=_counts,
    help="Train a detector with each of these numbers of the real frames, e.g. 0,10,30,100.",
)
@click.option(
    "--from",
    "start",
    metavar="DETECTOR",
    help="Start from the weights of this detector: bundled, or a folder. Takes about 11 minutes.",
)
@_seed(help="Seed of weights, order, augmentation and frames.")
@click.option("--quick", is_flag=True, help="About a fifth of the time.")
@click.option("--epochs", type=int, help="Epochs of each network.  [default: chosen by time]")
@click.option("--batch", type=int, help="Batch size.  [default: 16 of the first network, 32 of the second]")
@click.option("--patience", default=0, show_default=True, help="Stop after so many epochs without gain; 0 never does.")
@_of_detectors
def detector(
    datasets: tuple[Path, ...], out: Path, grab: Path | None, scene: str | None, frames: int | None,
    also: tuple[Path, ...], real: tuple[Path, ...], grab_classes: tuple[str, ...],
    counts: tuple[int, ...], start: str | None, seed: int, quick: bool, epochs: int | None, batch: int | None,
    patience: int, device: str, threads: int, half: bool | None, resume: bool, as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Train the detector from DATASETS of `simgrab render`: trained on their split train, validated on val.

    OUT gets coarse.onnx and pose.onnx, which --detector takes as a folder, each with a model card.
    --from bundled --grab FILE trains on rendered frames of your own grab, in about 30 minutes on two cores.
    Figures of rendered and of real frames are kept apart.
    """
    from simgrab.training import need_torch
    from simgrab.training.folder import CURVE, TRACES, check

    for wrong, problem in (
        (grab is not None and scene is not None, "give --grab or --scene, not both"),
        (not (datasets or grab or scene), "give DATASETS, --grab or --scene"),
        (frames is not None and not (grab or scene), "--frames belongs to --grab and --scene"),
        (counts and not also, "--learning-curve belongs to --also"),
        (grab_classes and not (also or real), "--grab-class belongs to --also and --real"),
    ):
        if wrong:
            raise click.UsageError(problem)
    # Before torch is imported, which takes seconds.
    check(out, resume=resume, traces=CURVE if counts else TRACES)
    need_torch()
    from simgrab.dataset.datasets import read
    from simgrab.instrument.detect import GrabDetector, located
    from simgrab.judge.own_grab import remarks
    from simgrab.training.detector import curve
    from simgrab.training.detector import real as real_frames
    from simgrab.training.detector.settings import recipes
    from simgrab.training.detector.train import train
    from simgrab.training.device import named

    begin = None if start is None else located(start)
    shows = not (quiet or as_json)
    known = real_frames.read(also, real, grab_classes) if also or real else None
    for line in known.summary if known and shows else ():
        click.echo(printable(f"real frames of {line}"), err=True)
    if known and counts:
        known.some(counts[-1], seed)  # or refused
    asked, full = None, out.absolute()
    rendered = full.with_name(f"{full.name}-frames")
    if grab or scene:  # frames take minutes: what can be refused is refused before
        named(device)
        if begin is not None:
            GrabDetector(begin)
        for dataset in datasets:
            read(dataset)
        asked = _asked(grab, scene, frames, seed)
        for line in remarks(asked.grab) if shows else ():
            click.echo(printable(f"grab.file: {line}"), err=True)
    chosen = functools.partial(
        recipes, quick=quick, started=start is not None, epochs=epochs, batch=batch, half=half, seed=seed,
        patience=patience, device=device, threads=threads,
    )  # fmt: skip
    with resumable(out, *[rendered] * (asked is not None)):
        if asked is not None:
            _render(asked, rendered, shown=shows)
            datasets = (*datasets, rendered)
        with board(shown=shows) as shown:
            follows = functools.partial(follow, shown)
            if counts:
                assert known is not None
                points = curve.learning_curve(
                    datasets, out, chosen, known, counts, seed=seed, start=begin, resume=resume,
                    watch=shown.step, report=follows,
                )  # fmt: skip
            else:
                metrics = train(
                    datasets, out, chosen, real=known, start=begin, resume=resume, watch=shown.step, report=follows
                )
    if counts:
        _print_curve(points, out, as_json=as_json, quiet=quiet)
        return
    _print_metrics(metrics, out / "pose.md", as_json=as_json, quiet=quiet)
    if not quiet and not metrics["recall"]:
        click.echo("no grab of the validation frames is detected: train on more frames, or for longer", err=True)


def _print_curve(points: Sequence[Mapping[str, Any]], out: Path, *, as_json: bool, quiet: bool) -> None:
    from simgrab.reports.terminal import stdout, table
    from simgrab.training.detector.curve import MARKDOWN, tables

    if as_json:
        click.echo(json.dumps(points))
    elif not quiet:
        for title, (head, *rows) in tables(points).items():
            stdout().print(table(rows, head, title))
        click.echo(printable(f"table: {out / MARKDOWN}"))


def _asked(grab: Path | None, scene: str | None, frames: int | None, seed: int) -> Scenario:
    """Scenario of the frames to render: of a user's own grab, or of a scene."""
    from simgrab.judge import own_grab
    from simgrab.model import scenes
    from simgrab.training.detector.own_grab import FRAMES, scene_of

    if grab is not None:
        return scene_of(own_grab.grab_of(grab), frames=frames or FRAMES, seed=seed)
    assert scene is not None
    drawn = scenes.load(scene, {"seed": seed} | ({} if frames is None else {"frames": frames}))
    if not drawn.vary:
        raise click.UsageError(f"{printable(scene)} lets nothing vary: all of its frames would show one world")
    return drawn


def _render(scene: Scenario, out: Path, *, shown: bool) -> None:
    """Render a scene's frames, or what is missing of them."""
    from simgrab.dataset.pool import automatic
    from simgrab.dataset.render import render
    from simgrab.world.extensions import Recipe

    workers, _ = automatic(Recipe(scene))
    with drawing("rendering frames", shown=shown) as (progress, checking):
        render(scene, out, workers=workers, resume=True, progress=progress, checking=checking)


@command.command()
@click.argument("datasets", nargs=-1, required=True, type=PATH)
@click.option("--out", type=FOLDER, required=True, help="Folder for network, card and checkpoint.")
@_seed(help="Seed of weights, order and augmentation.")
@click.option("--quick", is_flag=True, help="A third of the time.")
@click.option("--epochs", type=int, help="Epochs.  [default: 20, or 6 with --quick]")
@click.option("--batch", default=128, show_default=True, help="Batch size.")
@click.option("--patience", default=8, show_default=True, help="Stop after so many epochs without gain; 0 never does.")
@click.option("--threads", default=1, show_default=True, help="torch threads; the weights depend on it.")
@_training
def reader(
    datasets: tuple[Path, ...], out: Path, seed: int, quick: bool, epochs: int | None, batch: int, patience: int,
    device: str, threads: int, resume: bool, as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Train the reader of the display's digits from DATASETS of `simgrab render` that show rope lengths.

    OUT gets reader.onnx, with a model card. The scene `digits` is made for this.
    """
    from simgrab.training import need_torch
    from simgrab.training.folder import check

    check(out, resume=resume)  # before torch is imported, which takes seconds
    need_torch()
    from simgrab.training.reader.train import QUICK_EPOCHS, RECIPE, train_reader

    recipe = dataclasses.replace(
        RECIPE, seed=seed, epochs=(QUICK_EPOCHS if quick else RECIPE.epochs) if epochs is None else epochs,
        batch=batch, patience=patience, device=device, threads=threads,
    )  # fmt: skip
    with resumable(out), board(shown=not (quiet or as_json)) as shown:
        card = train_reader(datasets, out, recipe, resume=resume, report=follow(shown, "reader"))
    _print_metrics(card.metrics, out / "reader.md", as_json=as_json, quiet=quiet)
