"""Take the picture of docs/studio.md: `simgrab studio` in headless Chromium.

python -m scripts.studio_picture
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from scripts.chromium import page
from simgrab.model import scenes
from simgrab.pages.studio import studio

PICTURE = Path(__file__).parents[1] / "docs" / "studio.jpg"
SIZE = (1280, 1010)
MOST_BYTES = 200_000
SCENE = "port"
CHANGES = {
    "name": SCENE, "description": "Coal on the quay apron, with a display.", "display.layout": "two-by-four", "seed": 1,
    "camera.beta_deg": 4.0, "swing.alpha.sigma_deg": 6.0, "frames": 16,
}  # fmt: skip
FULL = 'document.querySelector("[data-side=a]")?.dataset.small === "false"'
MEASURED = 'document.querySelector("#panel-instrument progress")?.value >= 16'


def main() -> None:
    """Open the page on a changed scene, and save what it shows with the best quality that is small enough."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{SCENE}.toml"
        path.write_text(scenes.load("quay-day", CHANGES, size=(960, 540)).to_toml(), encoding="utf-8")
        with studio.serving(studio.open(path, folder)) as address, page() as shown:
            shown.look(*SIZE)
            shown.open(address.url)
            shown.wait(FULL)
            shown.evaluate("""(() => {
              document.querySelector("[data-layer=keypoints]").click();
              document.getElementById("tab-instrument").click();
              const search = document.getElementById("search");
              search.value = "deg";
              search.dispatchEvent(new Event("input"));
              for (const one of document.querySelectorAll(".section")) one.open = true;
            })()""")
            shown.wait(MEASURED, 60)
            for quality in range(85, 40, -5):
                shown.photograph(PICTURE, quality=quality)
                if PICTURE.stat().st_size <= MOST_BYTES:
                    return


if __name__ == "__main__":
    main()
