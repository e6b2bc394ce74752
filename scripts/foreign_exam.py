"""Judge detectors on pictures not rendered by simgrab: ``scripts/python -m scripts.foreign_exam --blender PYTHON``.

PYTHON is an interpreter that can import bpy, Blender as a module (GPL; simgrab does not depend on it). Without it the
worlds that are complete are scored, also of a run in progress. Each world has one frame. simgrab labels it and renders
it with MuJoCo; Blender path-traces the same geometry by the same camera at the same moment:

    mujoco, cycles      textures, light, lens and sensor are simgrab's, and so is the grab
    mujoco-grab, grab   a grab by other code, which simgrab labels as a user's own

Whatever is made stays in the folder, and the same command goes on where it was interrupted. Worlds of the half "final"
are held out: score them once, at the end.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import cv2
import msgspec
from rich.console import Console

from scripts.foreign.making import Blender, Maker, truth
from scripts.foreign.worlds import PICTURES, SEEDS, World
from scripts.score_detector import WIDTH, boxes_tables, centres_tables
from simgrab.cli import main as run
from simgrab.dataset import preview
from simgrab.dataset.record import FrameRecord
from simgrab.errors import RendererError, ScenarioError
from simgrab.instrument.detect import Detector
from simgrab.instrument.detect import detector as opened
from simgrab.io import pictures
from simgrab.io.files import write
from simgrab.judge.evaluate import detection
from simgrab.model import label_arrays as labels
from simgrab.model import scenes
from simgrab.model.scenario import Labels

DETECTORS = ("bundled",)
TILE_PX = (480, 270)


def make(maker: Maker, worlds: Sequence[World]) -> dict[str, str]:
    """Make what is missing; returns why a world is not made, by its name. Another run tries it again."""
    refused = {}
    for number, world in enumerate(worlds, 1):
        start = time.monotonic()
        try:
            maker.make(world)
        except (ScenarioError, RendererError) as problem:  # its grab does not fit into its place, or Blender crashed
            refused[world.name] = str(problem)
        click.echo(f"{world.name} ({number} of {len(worlds)}): {time.monotonic() - start:.1f} s", err=True)
    return refused


def complete(folder: Path) -> bool:
    """Whether all pictures of a world are made."""
    return all(truth(folder, geometry).exists() for geometry in PICTURES)


def score(root: Path, worlds: Sequence[World], nets: Mapping[str, Detector]) -> dict[str, Any]:
    """Run detectors on the complete worlds' pictures.

    Returns
    -------
    dict
        ``worlds``: how many are complete; ``incomplete``: the names of the others. ``detectors``: by detector and
        picture, as `simgrab.judge.evaluate.detection.figures` gives, also of each time of day and family of grabs.
    """
    done = [world for world in worlds if complete(root / world.name)]
    cases = dict[str, dict[str, list[detection.Case]]]()
    for world, (geometry, names) in itertools.product(done, PICTURES.items()):
        folder = root / world.name
        row = msgspec.json.decode(truth(folder, geometry).read_bytes(), type=FrameRecord).truth
        labelled = labels.is_labelled(row, Labels().least_visible_fraction)
        for name, (key, net) in itertools.product(names, nets.items()):
            found = net(pictures.read(folder / f"{name}.jpg"))
            case = detection.Case(row, labelled, found, world.time, world.name)
            for group in (name, f"{name}, {world.time}", f"{name}, {world.family}"):
                cases.setdefault(key, {}).setdefault(group, []).append(case)
    return {
        "worlds": len(done),
        "incomplete": [world.name for world in worlds if world not in done],
        "detectors": {
            key: {group: detection.figures(some) for group, some in sorted(groups.items())}
            for key, groups in cases.items()
        },
    }


def show(scores: dict[str, Any]) -> None:
    """Print the tables."""
    console = Console(width=WIDTH)
    for name, groups in scores["detectors"].items():
        centres = centres_tables({group: figures["centre"] for group, figures in groups.items()})
        console.print(*boxes_tables(name, groups), *centres, sep="\n")


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--blender", metavar="PYTHON", help="Interpreter that can import bpy; without it, only score.")
@click.option("--worlds", "count", default=48, show_default=True, type=click.IntRange(min=1))
@click.option("--first", default=0, show_default=True, type=click.IntRange(min=0), help="Number of the first world.")
@click.option("--half", type=click.Choice(list(SEEDS)), default="tune", show_default=True)
@click.option("--size", default="960x540", show_default=True)
@click.option("--samples", default=8, show_default=True, help="Of the path tracer, a pixel; it denoises.")
@click.option("--threads", default=1, show_default=True, help="Of the path tracer.")
@click.option("--detector", "detectors", multiple=True, default=DETECTORS, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/foreign"), show_default=True)
def main(
    blender: str | None, count: int, first: int, half: str, size: str, samples: int, threads: int,
    detectors: tuple[str, ...], out: Path,
) -> None:  # fmt: skip
    """Make the pictures, score them, and write figures and contact sheets."""
    pixels, worlds = scenes.parse_size(size), [World(half, first + number) for number in range(count)]
    root, refused = out / "worlds", {}
    stated = {"size": list(pixels), "samples": samples}
    setting = out / "setting.json"
    if setting.exists() and json.loads(setting.read_text()) != stated:
        raise click.UsageError(f"{out} holds pictures of {json.loads(setting.read_text())}; choose another --out")
    write(setting, json.dumps(stated) + "\n")
    if blender:
        refused = make(Maker(root, pixels, samples, threads, Blender(blender)), worlds)
    found = score(root, worlds, {name: opened(name) for name in detectors})
    write(out / f"scores-{half}.json", json.dumps(stated | {"half": half, "refused": refused} | found, indent=1) + "\n")
    for name in itertools.chain(*PICTURES.values()):
        paths = [root / world.name / f"{name}.jpg" for world in worlds if complete(root / world.name)]
        tiles = [cv2.resize(pictures.read(path), TILE_PX, interpolation=cv2.INTER_AREA) for path in paths]
        if tiles:
            sheet = cv2.cvtColor(preview.sheet(tiles), cv2.COLOR_RGB2BGR)
            write(out / f"sheet-{half}-{name}.jpg", pictures.encode(sheet, "jpeg", 88))
    show(found)
    for world, why in refused.items():
        click.echo(f"{world} is not made: {why}", err=True)


if __name__ == "__main__":
    run(main)
