"""Displays of known digits over pictures that the camera has taken: how a reader is tried on more than can be rendered.

A video recorder lays its display over the picture after lens and sensor, and codes both together; so does
`simgrab.world.camera.pipeline`. Rendering is slow and adding a display is fast. So a scene's
pictures are rendered once without a display, and any number of random displays is laid over them and coded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset.video.coder import Coder
from simgrab.errors import DatasetError
from simgrab.io.files import write
from simgrab.io.pictures import encode
from simgrab.io.pictures import read as read_picture
from simgrab.model import scenes
from simgrab.model.layouts import Layout, Rectangle
from simgrab.model.rng import stream
from simgrab.model.scenario import Scenario
from simgrab.world import frames
from simgrab.world.camera.faces import Face
from simgrab.world.camera.overlay import Overlay
from simgrab.world.trajectory.clock import clock_text
from simgrab.world.trajectory.display import Shown

Picture = NDArray[np.uint8]

CODING_UNIT_PX = 16  # what JPEG with halved chroma codes on its own
_TICKS_PER_S = 90_000
_SHAKE_PX = 2  # a frame, of the picture behind the display
_REFRESH_M = 0.25  # a rope gets so far between two refreshes
_FIRST = datetime(1971, 1, 1)


@dataclass(frozen=True, eq=False)
class Trial:
    """A picture with a display of known digits.

    Attributes
    ----------
    rgb : ndarray of uint8, shape (height, width, 3)
        Decoded. Only valid until the next trial is taken.
    shown : Shown
    """

    rgb: Picture
    shown: Shown


def backdrops(scene: str, folder: Path, count: int, seed: int) -> list[Picture]:
    """Take pictures of a scene without its display, or read those that were taken before.

    Parameters
    ----------
    scene : str
        A bundled scene of independent frames.
    folder : Path
        Where they are kept, as PNG.
    count : int
    seed : int
        Of the scene; another than any that was trained on.
    """
    scenario = scenes.load(scene, {"display.layout": "none", "seed": seed})
    if count > scenario.frames:
        raise DatasetError(f"{scene} has {scenario.frames} frames, of which {count} cannot be taken")
    taken = {
        folder / f"{scene}-{scenario.digest()[:16]}-{frame:06d}.png": frame for frame in _spread(scenario.frames, count)
    }
    missing = {path: frame for path, frame in taken.items() if not path.exists()}
    if missing:
        for path, frame in zip(missing, frames.frames(scenario, missing.values(), buffers=False), strict=True):
            write(path, encode(frame.rgb[..., ::-1], "png"))
    return [read_picture(path) for path in taken]


def _spread(of: int, count: int) -> range:
    step = of // count
    return range(0, step * count, step)


def displays(layout: Layout, count: int, seed: int, *, torn: bool = False) -> Iterator[Shown]:
    """Draw displays: every digit in every cell as likely, and any clock.

    Parameters
    ----------
    layout : Layout
        Fitted to the picture.
    count, seed : int
    torn : bool
        Tear each in a row of its digits, the lengths below being up to 0.25 m from those above.
    """
    for k in range(count):
        rng = stream(seed, k, "displays")
        clock = clock_text(_FIRST, float(rng.integers(0, 4_000_000_000)))
        digits = "".join(map(str, rng.integers(0, 10, 8)))
        text = layout.written(digits)
        if not torn:
            yield Shown(clock, text, text, None)
            continue
        below = layout.text(*(m + d for m, d in zip(layout.lengths(digits), _moved(rng), strict=True)))
        tops = [y0 for _, y0, _, _ in layout.cells]
        yield Shown(clock, text, below, int(rng.integers(min(tops) + 1, max(tops) + layout.digit_height_px)))


def _moved(rng: np.random.Generator) -> tuple[float, float]:
    hoist, closing = rng.uniform(-_REFRESH_M, _REFRESH_M, 2)
    return float(hoist), float(closing)


def stills(
    pictures: Sequence[Picture], layout: Layout, shown: Iterator[Shown], quality: int, face: Face | None = None
) -> Iterator[Trial]:
    """Lay displays over pictures, one after another, and code each as JPEG.

    What lies a coding unit from the digits does not change them: it stays uncoded. ``face`` is another one than the
    bundled font's.
    """
    overlay, (x0, y0, x1, y1) = Overlay(layout, face), _coded(layout)
    canvases = [picture.copy() for picture in pictures]
    for k, one in enumerate(shown):
        picture, canvas = pictures[k % len(pictures)], canvases[k % len(pictures)]
        with_display = overlay.blend(picture, one)[y0:y1, x0:x1]
        data = encode(with_display[..., ::-1], "jpeg", quality)
        coded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        canvas[y0:y1, x0:x1] = np.asarray(coded)[..., ::-1]
        yield Trial(canvas, one)


def _coded(layout: Layout) -> Rectangle:
    """Whole coding units around the digits, with one more on every side."""
    cells, unit = np.array(layout.cells), CODING_UNIT_PX
    x0, y0 = (cells[:, :2].min(0) // unit - 1) * unit
    x1, y1 = (-(-cells[:, 2:].max(0) // unit) + 1) * unit
    return max(int(x0), 0), max(int(y0), 0), min(int(x1), layout.width_px), min(int(y1), layout.height_px)


def video(
    pictures: Sequence[Picture], layout: Layout, shown: Iterator[Shown], scenario: Scenario, seed: int
) -> Iterator[Trial]:
    """Lay displays over one picture after another, code them as a clip of the scenario's bit rate, and decode it.

    The picture behind shakes by a pixel or two from frame to frame and is another one at every key frame; the digits
    are others in every frame.
    """
    overlay, clip, all_shown = Overlay(layout), scenario.clip, list(shown)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "trial.mp4"
        with Coder(path, "mp4", _TICKS_PER_S, scenario.camera, clip) as coder:
            for k, one in enumerate(all_shown):
                picture = pictures[k // clip.gop_frames % len(pictures)]
                shift = stream(seed, k, "shake").integers(-_SHAKE_PX, _SHAKE_PX + 1, 2)
                shaken = np.roll(picture, (int(shift[0]), int(shift[1])), axis=(0, 1))
                coder.send(overlay.blend(shaken, one), round(k * _TICKS_PER_S / clip.frame_rate_hz))
        with av.open(str(path)) as file:
            for frame, one in zip(file.decode(video=0), all_shown, strict=True):
                yield Trial(np.asarray(frame.to_ndarray(format="rgb24")), one)
