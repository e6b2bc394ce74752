"""Contact sheets of the kinds of grabs, closed to open, near to far: ``python -m scripts.grab_sheets``.

Each sheet has 24 random grabs of a kind, with ropes of 8 to 35 m; a scene file with an own grab gives one of that grab.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import click
import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

import simgrab
from simgrab.cli import main as run
from simgrab.model import label_arrays as labels
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.grab import Grab
from simgrab.model.scenario.surroundings import Kind
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.drawn import any_of

KINDS = get_args(Kind)
TILES, COLUMNS, SIDE_PX = 24, 6, 320
ROPES_M = (8.0, 35.0)
VOLUMES_M3 = (3.0, 20.0)


def drawn(kind: str) -> list[Grab]:
    """Draw the grabs of a sheet."""
    rng = np.random.default_rng(0)
    return [any_of(kind, rng, VOLUMES_M3) for _ in range(TILES)]


def sheet(grabs: list[Grab]) -> NDArray[np.uint8]:
    """Render grabs, each with a longer rope and wider jaws than the one before; BGR."""
    tiles = []
    for i, grab in enumerate(grabs):
        share = i / (len(grabs) - 1)
        rope = float(np.interp(share, (0, 1), ROPES_M))
        jaw = float(np.degrees(design_of(grab).max_jaw)) * (i % COLUMNS) / (COLUMNS - 1)
        frame = next(iter(simgrab.frames(_scene(grab, rope, jaw, seed=i))))
        box = labels.box(frame.truth)
        assert box is not None
        centre, reach = (box[:2] + box[2:]) / 2, 0.55 * float((box[2:] - box[:2]).max())
        scale = SIDE_PX / (2 * reach)
        view = np.array([[scale, 0, SIDE_PX / 2 - scale * centre[0]], [0, scale, SIDE_PX / 2 - scale * centre[1]]])
        tile = cv2.warpAffine(frame.rgb[..., ::-1].copy(), view, (SIDE_PX, SIDE_PX), flags=cv2.INTER_AREA)
        cv2.putText(tile, f"{rope:.0f} m, {jaw:.0f} deg", (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
        tiles.append(tile)
    rows = [np.concatenate(tiles[i : i + COLUMNS], axis=1) for i in range(0, len(tiles), COLUMNS)]
    return np.concatenate(rows)


def _scene(grab: Grab, rope_m: float, jaw_deg: float, *, seed: int) -> Scenario:
    def only(value: float) -> dict[str, Any]:
        return {"dist": "choice", "values": [value], "weights": [1]}

    scene = scenes.load(
        "quay-day",
        {
            "frames": 1, "seed": seed,
            "place": {"model": "hold", "fill": 0.05, "depth_m": 17.0}, "jib.head_height_m": 33.0,
            "camera.beta_deg": 3.0,
            "swing.alpha.sigma_deg": 1.5,
            "swing.rope_length_m": only(rope_m), "swing.jaw_deg": only(jaw_deg), "swing.load": only(float(seed % 2)),
            "swing.yaw_deg": {"dist": "uniform", "low": -180, "high": 180},
        },
    )  # fmt: skip
    return msgspec.structs.replace(scene, grab=grab)


@click.command()
@click.argument("kinds", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/sheets"), show_default=True)
def main(kinds: tuple[str, ...], out: Path) -> None:
    """Draw sheets of KINDS, which may be scene files; of all kinds where none is given."""
    out.mkdir(parents=True, exist_ok=True)
    for kind in kinds or KINDS:
        known = kind in KINDS
        path = out / f"{kind if known else Path(kind).stem}.jpg"
        cv2.imwrite(str(path), sheet(drawn(kind) if known else [scenes.load(kind).grab] * TILES))
        click.echo(path)


if __name__ == "__main__":
    run(main)
