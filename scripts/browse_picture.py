"""Take the picture of docs/browsing.md: `simgrab browse` over rendered frames, in headless Chromium.

python -m scripts.browse_picture [DATASET]
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

import simgrab
from scripts.chromium import page
from simgrab.pages.browse import browse

PICTURE = Path(__file__).parents[1] / "docs" / "browsing.jpg"
SIZE = (1280, 800)
FRAMES = 192
MOST_BYTES = 200_000
VIEW = "#sort=-alpha_deg&labels=box,keypoints&range.alpha_deg=2..&range.visible_fraction=0.5.."


def photograph(dataset: Path) -> None:
    """Open the page on a dataset, and save what it shows with the best quality that is small enough."""
    with browse.serving(browse.open(dataset)) as address, page() as shown:
        shown.look(*SIZE)
        shown.open(f"{address.url}{VIEW}")
        shown.wait('document.body?.dataset.ready === "yes"')
        shown.wait('[...document.querySelectorAll("#grid img")].slice(0, 16).every((image) => image.complete)')
        shown.evaluate(f'document.getElementById("name").textContent = "runs/{simgrab.open(dataset).scenario.name}"')
        for quality in range(85, 40, -5):
            shown.photograph(PICTURE, quality=quality)
            if PICTURE.stat().st_size <= MOST_BYTES:
                return


@click.command()
@click.argument("dataset", type=click.Path(path_type=Path), required=False)
def main(dataset: Path | None) -> None:
    """Render frames of `training`, or take DATASET, and save docs/browsing.jpg."""
    if dataset is not None:
        photograph(dataset)
        return
    with tempfile.TemporaryDirectory() as folder:
        simgrab.render(simgrab.load("training", {"frames": FRAMES}, size=(640, 360)), Path(folder) / "training")
        photograph(Path(folder) / "training")


if __name__ == "__main__":
    main()
