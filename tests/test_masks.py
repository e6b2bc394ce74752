"""Masks from COCO files are those that were written, or are refused in one line."""

import json

import numpy as np
import pytest
from pycocotools import mask as coco_mask

import simgrab
from simgrab.errors import DatasetError
from simgrab.model import masks


def written(mask):
    coded = coco_mask.encode(np.asfortranarray(mask, np.uint8))
    return coded["counts"].decode()


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (3, 5), (64, 48), (600, 800)])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_a_mask_is_the_one_that_was_written(size, share):
    rng = np.random.default_rng(0)
    for mask in (rng.random(size) < share, np.repeat(rng.random(size[1]) < share, size[0]).reshape(size, order="F")):
        np.testing.assert_array_equal(masks._decoded(written(mask), *size), mask)


@pytest.mark.parametrize(
    "counts", ["", "zzzzzz", "0", "é", "\x00", "T3" * 20, "o" * 8 + "0", written(np.ones((10, 11))), "0" * 200, "d3N"]
)
def test_run_lengths_that_do_not_hold_the_picture_are_refused(counts):
    with pytest.raises(ValueError, match=r"run lengths|RLE"):
        masks._decoded(counts, 10, 10)


@pytest.mark.parametrize(
    ("segmentation", "why"),
    [
        ({"size": [10, 10], "counts": written(np.ones((10, 10)))}, "it is of 10 x 10 px"),
        ({"size": [100_000, 100_000], "counts": ""}, "it is of 100000 x 100000 px"),
        ({"size": [-1, 3], "counts": ""}, "it is of 3 x -1 px"),
        ({"size": [None, None], "counts": ""}, "Expected `int`, got `null`"),
        ({"size": "whole", "counts": ""}, "its run lengths cannot be decoded"),
        ({"size": "whole", "counts": "zzzzzz"}, "run lengths|RLE"),
        ({"size": "whole", "counts": [1, 2]}, "Expected `str`, got `array`"),
        ({"size": [3, 3]}, "missing required field `counts`"),
        ([[0, 0, 1, 1]], "Expected `object`, got `array`"),
        ('{"unknown": ' + "[" * 5000 + "]" * 5000 + "}", "recursion"),
    ],
)
def test_a_mask_of_another_picture_is_refused(copy, segmentation, why):
    frame = next(frame for frame in simgrab.open(copy) if frame.labelled)
    row = frame.truth
    file = copy / "annotations" / f"instances_{row.split}.json"
    known = json.loads(file.read_text())
    if isinstance(segmentation, dict) and segmentation["size"] == "whole":
        segmentation = segmentation | {"size": [row.height_px, row.width_px]}
    annotation = next(one for one in known["annotations"] if one["image_id"] == row.frame)
    annotation["segmentation"] = "MASK"
    text = segmentation if isinstance(segmentation, str) else json.dumps(segmentation)
    file.write_text(json.dumps(known).replace('"MASK"', text))
    with pytest.raises(DatasetError, match=why) as problem:
        _ = frame.mask
    assert str(file) in str(problem.value)
    if "size" in segmentation and "counts" in segmentation and "Expected" not in why:
        assert f"the mask of frame {row.frame}" in str(problem.value)


def test_a_coco_file_is_not_read_beyond_its_limit(copy, monkeypatch):
    frame = next(frame for frame in simgrab.open(copy) if frame.labelled)
    monkeypatch.setattr(masks, "MOST_COCO_BYTES", 1000)
    with pytest.raises(DatasetError, match="the limit is 1000 bytes"):
        _ = frame.mask
