"""Render clips, measure them by the bundled instrument or another detector, and print what limits the angle in each.

    scripts/python -m scripts.error_budget [--minutes 5] [--rate 3] [--only calm] [--work runs/budget]
        [--grab SCENE] [--detector FOLDER]

Working cycles with the camera 0.6 m beside the rope exit, through picture, detector and reader; the camera file states
an offset that errs by 5 cm per coordinate. What was rendered is kept; an interrupted call goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np

from simgrab.cli._progress import bar
from simgrab.dataset.render import render
from simgrab.instrument.pipeline import assemble
from simgrab.instrument.run.run import measure
from simgrab.instrument.source import open_source
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.judge.evaluate.table import tables
from simgrab.model import calibration, scenes
from simgrab.model.calibration import Calibration
from simgrab.model.rng import stream
from simgrab.model.scenario import Grab
from simgrab.reports.terminal import cell, stdout, table

OFFSET_SD_M = 0.05
FIXED = {"camera.mount": {"model": "fixed"}, "display.layout": "two-by-four"}
CYCLES = {"model": "cycles", "dig_rope_m": 22.5, "carry_rope_m": 10.0, "dig_slew_deg": 15.0, "slew_deg": -32.0}


def working(wind_m_s: float) -> dict[str, Any]:
    """Make a scene of independent frames work in cycles, in a wind."""
    return {"swing": {"model": "dynamic", "work": CYCLES, "wind": {"mean_m_s": wind_m_s}}}


# Scene and what differs from it.
CLIPS: dict[str, tuple[str, Mapping[str, Any]]] = {
    "calm": ("work-cycles", FIXED),
    "calm, no offset": ("work-cycles", FIXED | {"camera.offset_y_m": 0.0, "camera.offset_z_m": 0.0}),
    "windy, 14 m/s": ("windy-day", FIXED | working(14.0)),
    "night, light snow": ("night-light-snow", FIXED | working(4.0)),
    "heavy snow": ("heavy-snow", FIXED | working(7.0)),
    "alarm": ("alarm-cycles", FIXED),
    "calm, levelled camera": ("work-cycles", {"display.layout": "two-by-four"}),
}


def budget(
    name: str, out: Path, settings: Mapping[str, Any], workers: int, grab: Grab | None = None, detector: str = "bundled"
) -> dict[str, Any]:
    """Render one clip, or what is missing of it, measure and evaluate."""
    scene, changes = CLIPS[name]
    settings = {**changes, **settings}
    scenario = scenes.load(scene, settings)
    if grab is not None:
        scenario = msgspec.structs.replace(scenario, grab=grab)
    with bar(f"drawing {name}", shown=True) as progress:
        render(scenario, out, workers=workers, resume=True, progress=progress)
    camera = measured_offset(calibration.load(out / "camera.toml"), settings["seed"])
    source = open_source(out)
    found = evaluate(measure(source, camera, assemble(detector=detector), source=source.name), out).to_dict()
    out.with_suffix(".json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    return found


def measured_offset(camera: Calibration, seed: int) -> Calibration:
    """Let a camera file's offset err as a measured one does; rendered ones state it as it is."""
    x, y, z = (np.array(camera.offset_m) + stream(seed, 0, "offset").normal(0, OFFSET_SD_M, 3)).tolist()
    return msgspec.structs.replace(camera, offset_m=(x, y, z), offset_sd_m=OFFSET_SD_M)


def show(name: str, found: Mapping[str, Any]) -> None:
    """Print what `simgrab evaluate` prints, below a clip's name."""
    console = stdout()
    console.rule(name)
    for each in tables(found):
        console.print(table(each.rows, each.head, each.title))
        console.print(cell(each.note), highlight=False)


@click.command()
@click.option("--minutes", default=5.0, show_default=True)
@click.option("--rate", default=3.0, show_default=True, help="Frames a second.")
@click.option("--only", "names", multiple=True, type=click.Choice(list(CLIPS)), help="As often as wanted.")
@click.option("--seed", default=11, show_default=True)
@click.option("--grab", help="Scene whose grab hangs there, in place of the usual one.")
@click.option("--detector", default="bundled", show_default=True, help="Or a trained folder, or a YOLO's .onnx.")
@click.option("--work", type=click.Path(path_type=Path), default=Path("runs/budget"), show_default=True)
@click.option("--workers", default=2, show_default=True)
def main(
    minutes: float, rate: float, names: tuple[str, ...], seed: int, grab: str | None, detector: str, work: Path,
    workers: int,
) -> None:  # fmt: skip
    """Print the error budgets."""
    work.mkdir(parents=True, exist_ok=True)
    settings = {"frames": round(60 * minutes * rate), "clip.frame_rate_hz": rate, "seed": seed}
    other_grab = scenes.load(grab).grab if grab else None
    for name in names or CLIPS:
        folder = work / name.replace(",", "").replace(" ", "-").replace("/", "-")
        show(name, budget(name, folder, settings, workers, other_grab, detector))


if __name__ == "__main__":
    main()
