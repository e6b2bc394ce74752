"""Make the bundled reader again from nothing: ``python -m scripts.build_reader [--quick]``.

Renders the scene `digits` (seed 0; 2,400 small frames), trains on it (seed 0), and puts ``reader.onnx`` with its card
into ``assets/weights``. ``--quick`` renders 960 frames and trains six epochs.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import click

from simgrab import scenes
from simgrab.resources import ASSETS
from simgrab.training.card import Card
from simgrab.training.progress import board
from simgrab.training.reader.train import NAME, QUICK_EPOCHS, RECIPE, train_reader
from simgrab.world.dataset import render

WEIGHTS = ASSETS / "weights"
WORK = Path("runs/build-reader")
QUICK_FRAMES = 960


def build_reader(work: Path = WORK, out: Path = WEIGHTS, *, quick: bool = False, workers: int = 2) -> Card:
    """Render, train, and put the reader in its place; goes on where an earlier call was interrupted.

    Parameters
    ----------
    work : Path
        Folder of what is made on the way.
    out : Path
        Folder of the weights and cards.
    quick : bool
    workers : int
        Processes that draw; the weights do not depend on it.
    """
    stem = "quick" if quick else "full"
    scenario = scenes.load("digits", {"frames": QUICK_FRAMES} if quick else {})
    recipe = dataclasses.replace(RECIPE, epochs=QUICK_EPOCHS) if quick else RECIPE
    with board(shown=True) as shown:
        summary = render(
            scenario, work / f"digits-{stem}", workers=workers, resume=True, progress=shown.step("drawing digits")
        )
        made = work / f"reader-{stem}"
        card = train_reader([summary.path], made, recipe, resume=True, report=shown.training("reader"))
    out.mkdir(parents=True, exist_ok=True)
    for suffix in (".onnx", ".json", ".md"):
        shutil.copyfile(made / f"{NAME}{suffix}", out / f"{NAME}{suffix}")
    return card


@click.command()
@click.option("--quick", is_flag=True, help="Fewer frames and epochs.")
@click.option("--work", type=click.Path(path_type=Path), default=WORK, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=WEIGHTS, help="Folder.  [default: assets/weights]")
@click.option("--workers", default=2, show_default=True, help="Processes that draw.")
def main(quick: bool, work: Path, out: Path, workers: int) -> None:
    """Make the bundled reader."""
    build_reader(work, out, quick=quick, workers=workers)
    click.echo((out / f"{NAME}.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
