"""Keep small pictures of bundled scenes, to detect a changed appearance: ``scripts/python -m scripts.make_golden``.

`tests/world/test_golden.py` asks for the same bytes with the same renderer and packages, and for similarity otherwise.
"""

from __future__ import annotations

import hashlib
import json
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import simgrab
from simgrab.world.frames import FrameGenerator

GOLDEN = Path(__file__).parents[1] / "tests" / "golden"
SCENES = ("quay-day", "quay-truck", "hold-coal", "water-side")
SMALL = {
    "camera.width_px": 480,
    "camera.height_px": 270,
    "camera.focal": {"model": "pixels", "focal_length_px": 411.204},
}


def draw(name: str) -> tuple[NDArray[np.uint8], str]:
    """Render frame 0 of a scene, small; returns it with a digest of its renderer."""
    with FrameGenerator(simgrab.load(name, SMALL)) as generator:
        drawn_by = [
            generator.scene(0).renderer.fingerprint.digest,
            *(version(p) for p in ("numpy", "opencv-python-headless", "scipy")),
        ]
        return generator.scene(0).renderer.rgb(generator.project(0).moment), " ".join(drawn_by)


def main() -> None:
    """Write the pictures and their digests."""
    GOLDEN.mkdir(exist_ok=True)
    digests = {}
    for name in SCENES:
        rgb, drawn_by = draw(name)
        cv2.imwrite(str(GOLDEN / f"{name}.png"), rgb[..., ::-1])
        digests[name] = {"drawn_by": drawn_by, "sha256": hashlib.sha256(rgb.tobytes()).hexdigest()}
    (GOLDEN / "digests.json").write_text(json.dumps(digests, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
