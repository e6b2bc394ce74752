"""Bundled scenes look as they did. After an intended change: ``scripts/python -m scripts.make_golden``, and look."""

import hashlib
import json

import cv2
import numpy as np
import pytest
from conftest import slow_but

from scripts.make_golden import GOLDEN, SCENES, draw

LIKENESS_DB = 30.0  # another renderer's edges and texture filters


@pytest.mark.parametrize("name", slow_but(SCENES, "quay-day"))
def test_a_scene_looks_as_it_did(name):
    rgb, drawn_by = draw(name)
    kept = json.loads((GOLDEN / "digests.json").read_text())[name]
    if drawn_by == kept["drawn_by"]:
        assert hashlib.sha256(rgb.tobytes()).hexdigest() == kept["sha256"]
    golden = cv2.imread(str(GOLDEN / f"{name}.png"))[..., ::-1]
    assert cv2.PSNR(np.ascontiguousarray(golden), np.ascontiguousarray(rgb)) > LIKENESS_DB
