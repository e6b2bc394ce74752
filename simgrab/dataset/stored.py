"""Encode a frame into the form that a dataset stores."""

from __future__ import annotations

import hashlib

import cv2
import msgspec
import numpy as np
from pycocotools import mask as coco_mask

from simgrab.dataset.record import FrameRecord, StoredFrame
from simgrab.io.pictures import encode
from simgrab.model.masks import Coded
from simgrab.model.truth import Row, Truth
from simgrab.world.camera.renderer import View
from simgrab.world.frames import Frame, FrameGenerator

DEPTH_MM = 1000.0  # depth pictures hold millimetres in 16 bits


def make(generator: FrameGenerator, number: int) -> StoredFrame:
    """Make one frame and encode it."""
    return encoded(generator, generator.frame(number, full=generator.scenario.image.stores_buffers))


def encoded(generator: FrameGenerator, frame: Frame) -> StoredFrame:
    """Encode a frame that the generator made."""
    image, number = generator.scenario.image, frame.truth.frame
    part = generator.recipe.split(number)
    stem = f"{part}/{number:06d}"
    name = f"images/{stem}.{'jpg' if image.format == 'jpeg' else 'png'}"
    files = {name: encode(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR), image.format, image.quality)}
    if frame.full and image.ids:
        files[f"ids/{stem}.png"] = encode(frame.full.ids, "png")
    if frame.full and image.depth:
        millimetres = np.minimum(frame.full.depth * DEPTH_MM, 65535).round().astype(np.uint16)
        files[f"depth/{stem}.png"] = encode(millimetres, "png")
    digest = hashlib.sha256(files[name]).hexdigest()
    row = Row(**msgspec.structs.asdict(frame.truth), split=part, file=name, image_sha256=digest)
    fingerprint = generator.scene(number).renderer.fingerprint
    return StoredFrame(FrameRecord(row, _coded(frame.grab, row), fingerprint), files)


def _coded(grab: View, truth: Truth) -> Coded:
    """Code the grab's mask, seen in a window, in the whole picture."""
    mask = np.zeros((truth.height_px, truth.width_px), np.uint8, order="F")
    x0, y0, x1, y1 = grab.window
    mask[y0:y1, x0:x1] = grab.shows_grab
    return Coded(mask.shape, coco_mask.encode(mask)["counts"].decode("ascii"))
