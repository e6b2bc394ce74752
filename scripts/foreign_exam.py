"""Judge detectors on pictures not rendered by simgrab: ``python -m scripts.foreign_exam --blender PYTHON``.

PYTHON is an interpreter that can import bpy, Blender as a module (GPL; simgrab does not depend on it). Without it the
worlds that are complete are scored, also of a run in progress. Each world has one frame. simgrab labels it and renders
it with MuJoCo; Blender path-traces the same geometry by the same camera at the same moment; then one thing at a time is
replaced, and at the end all:

    mujoco    simgrab's own picture
    cycles    the same, path-traced: geometry, textures, light, lens and sensor are simgrab's
    grab      a grab by other code; simgrab labels it as a user's own grab, and MuJoCo renders it too
    sensor    another sensor: mosaic, noise, denoising, sharpening and tone
    digits    the display in other fonts and colours
    all       all of these

Whatever is made stays in the folder, and the same command goes on where it was interrupted. Worlds of the half "final"
are held out: score them once, at the end.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import cv2
from rich.console import Console
from rich.table import Table

from scripts.foreign import scoring
from scripts.foreign.making import Blender, Maker, picture
from scripts.foreign.worlds import CONDITIONS, SEEDS, World, with_mujoco
from scripts.score_detector import WIDTH, boxes_table, centres_table
from simgrab.cli import main as run
from simgrab.dataset import preview
from simgrab.errors import RendererError, ScenarioError
from simgrab.instrument.detect import detector as opened
from simgrab.instrument.read import Reader
from simgrab.io import pictures
from simgrab.io.files import write
from simgrab.model import scenes

DETECTORS = ("bundled", "any-grab")
TILE_PX = (480, 270)


def make(maker: Maker, worlds: Sequence[World], names: Sequence[str]) -> dict[str, str]:
    """Make what is missing; returns why a world is not made, by its name. Another run tries it again."""
    refused = {}
    for number, world in enumerate(worlds, 1):
        start = time.monotonic()
        try:
            maker.make(world, names)
        except (ScenarioError, RendererError) as problem:  # its grab does not fit into its place, or Blender crashed
            refused[world.name] = str(problem)
        click.echo(f"{world.name} ({number} of {len(worlds)}): {time.monotonic() - start:.1f} s", err=True)
    return refused


def show(scores: dict[str, Any]) -> None:
    """Print the tables; MuJoCo's pictures of a condition's worlds are named ``mujoco`` or ``mujoco-grab``."""
    console = Console(width=WIDTH)
    for name, groups in scores["detectors"].items():
        console.print(boxes_table(name, groups))
        console.print(centres_table({group: figures["centre"] for group, figures in groups.items()}))
    digits = Table("digits", "right of those read", "refused")
    for one in scores["digits"]:
        shares = (one[key] for key in ("digits_right", "digits_refused"))
        digits.add_row(one["group"], *(f"{share['count']} of {share['of']}" for share in shares))
    console.print(digits)


def _names(_context: click.Context, _parameter: click.Parameter, value: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(part.strip() for part in value.split(","))) if value else tuple(CONDITIONS)
    unknown = [name for name in names if name not in CONDITIONS]
    if unknown:
        raise click.BadParameter(f"{', '.join(unknown)}: one or more of {', '.join(CONDITIONS)}")
    return names


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--blender", metavar="PYTHON", help="Interpreter that can import bpy; without it, only score.")
@click.option("--worlds", "count", default=48, show_default=True, type=click.IntRange(min=1))
@click.option("--first", default=0, show_default=True, type=click.IntRange(min=0), help="Number of the first world.")
@click.option("--half", type=click.Choice(list(SEEDS)), default="tune", show_default=True)
@click.option("--conditions", "names", default="", callback=_names, help="Separated by commas; all by default.")
@click.option("--size", default="960x540", show_default=True)
@click.option("--samples", default=8, show_default=True, help="Of the path tracer, a pixel; it denoises.")
@click.option("--threads", default=1, show_default=True, help="Of the path tracer.")
@click.option("--detector", "detectors", multiple=True, default=DETECTORS, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/foreign"), show_default=True)
def main(
    blender: str | None, count: int, first: int, half: str, names: tuple[str, ...], size: str, samples: int,
    threads: int, detectors: tuple[str, ...], out: Path,
) -> None:  # fmt: skip
    """Make the pictures, score them, and write figures and contact sheets."""
    pixels, worlds = scenes.parse_size(size), [World(half, first + number) for number in range(count)]
    refused = {}
    stated = {"size": list(pixels), "samples": samples}
    setting = out / "setting.json"
    if setting.exists() and json.loads(setting.read_text()) != stated:
        raise click.UsageError(f"{out} holds pictures of {json.loads(setting.read_text())}; choose another --out")
    write(setting, json.dumps(stated) + "\n")
    if blender:
        refused = make(Maker(out, pixels, samples, threads, Blender(blender)), worlds, names)
    nets = {name: opened(name) for name in detectors}
    found = scoring.score(out / "worlds", worlds, names, nets, Reader(), pixels)
    write(out / f"scores-{half}.json", json.dumps(stated | {"half": half, "refused": refused} | found, indent=1) + "\n")
    for name in with_mujoco(names):
        paths = [path for world in worlds if (path := picture(out / "worlds" / world.name, name))]
        tiles = [cv2.resize(pictures.read(path), TILE_PX, interpolation=cv2.INTER_AREA) for path in paths]
        if tiles:
            sheet = cv2.cvtColor(preview.sheet(tiles), cv2.COLOR_RGB2BGR)
            write(out / f"sheet-{half}-{name}.jpg", pictures.encode(sheet, "jpeg", 88))
    show(found)
    for world, why in refused.items():
        click.echo(f"{world} is not made: {why}", err=True)


if __name__ == "__main__":
    run(main)
