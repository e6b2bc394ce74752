"""Render a record and observe it: observation and truth of each frame."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset import preview
from simgrab.dataset.tables import calibration_of
from simgrab.errors import RendererError, SimgrabError, StressError
from simgrab.instrument import angles
from simgrab.instrument.angles import Seen
from simgrab.instrument.contract import Frame
from simgrab.instrument.observation import Observation, observe
from simgrab.instrument.pipeline import Pipeline, bundled
from simgrab.instrument.rope import rope
from simgrab.io.pictures import encode
from simgrab.io.resources import ASSETS
from simgrab.judge.doctor import examine
from simgrab.lab.stress.records import Picture
from simgrab.model import label_arrays as arrays
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import Iid, Scenario
from simgrab.world import frames as world_frames
from simgrab.world.frames import Frame as RenderedFrame

MOST_SHOWN = 8
_INSET_PX, _ZOOM = 100, 2
_TRUE, _FOUND = (40, 40, 255), (60, 220, 60)  # BGR


@dataclass(frozen=True, eq=False)
class Watched:
    """One replication of n frames.

    Attributes
    ----------
    scenario : Scenario
        Under the replication's own seed.
    calibration : Calibration
        Calibration that the instrument gets.
    seen : Seen
    truth : ndarray, shape (6, n)
        Of the swing α, azimuth (rad) and rope (m), of the camera β, azimuth and roll (rad).
    centre : ndarray, shape (n, 2)
        Where the pictures have the grab centre A, px.
    present : ndarray of bool, shape (n,)
        Whether there is a grab.
    """

    scenario: Scenario
    calibration: Calibration
    seen: Seen
    truth: Array
    centre: Array
    present: NDArray[np.bool_]

    @property
    def off_px(self) -> Array:
        """From the true to the found centre, shape (n,); NaN where none was found."""
        return np.asarray(np.linalg.norm(self.seen.pixels - self.centre, axis=-1))


def replication(scenario: Scenario, seed: int, trial: int) -> Scenario:
    """Give a scene the seed of a replication, the same at every point of a study; its frames are one clip."""
    own = int(stream(seed, trial, "stress.scene").integers(2**53))
    return msgspec.structs.replace(scenario, seed=own, clip=msgspec.structs.replace(scenario.clip, clip_frames=0))


def watch(scenario: Scenario, seed: int, trial: int) -> Watched:
    """Render one replication and observe each frame as the bundled pipeline does, keeping no picture.

    Raises
    ------
    StressError
        If a frame cannot be.
    """
    own, pipeline = replication(scenario, seed, trial), _pipeline()
    calibration = calibration_of(own)
    truth: list[tuple[float, ...]] = []

    def frames() -> Iterator[Frame]:
        timed = not isinstance(own.swing, Iid)
        for index, frame in enumerate(world_frames.frames(own, buffers=False)):
            truth.append(_truth(frame))
            time = index / own.clip.frame_rate_hz if timed else None
            yield Frame(coded(frame, own, cv2.IMREAD_COLOR_RGB), time)

    try:
        observations = tuple(observe(frames(), pipeline.detector, pipeline.reader, calibration))
    except SimgrabError as problem:
        raise StressError(f"replication {trial}: {problem}") from None
    found = angles.seen(observations, rope(observations, calibration, pipeline.bridge))
    rows = np.array(truth).T
    return Watched(own, calibration, found, rows[:6], rows[6:8].T, rows[8] > 0)


@functools.cache
def _pipeline() -> Pipeline:
    return bundled()


def _truth(frame: RenderedFrame) -> tuple[float, ...]:
    moment, (u, v) = frame.moment, arrays.centre(frame.truth)
    grab, tilt = moment.grab, moment.tilt
    swing = grab.alpha, grab.azimuth, grab.rope_length
    return *swing, tilt.beta, tilt.azimuth, tilt.roll, u, v, float(moment.present)


def coded(frame: RenderedFrame, scenario: Scenario, order: int) -> Picture:
    """Give a picture as a file of it would, in OpenCV's ``order`` of colours."""
    data = encode(frame.rgb[..., ::-1], scenario.image.format, scenario.image.quality)
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), order), np.uint8)


def made_with() -> str:
    """Name renderer, detector and reader, by digests."""
    found = examine()
    if found.renderer is None:
        raise RendererError(found.problem)
    weights = hashlib.sha256()
    for path in sorted((ASSETS / "weights").glob("*.onnx")):
        weights.update(path.read_bytes())
    return f"renderer {found.renderer.digest}, weights {weights.hexdigest()[:16]}"


def sheet(watched: Watched) -> Picture:
    """Draw the frames again in which the grab was missed, or found farthest from where it is (BGR)."""
    off = watched.off_px
    worst = np.argsort(np.where(np.isfinite(off), -off, -np.inf), kind="stable")[:MOST_SHOWN]
    shown = world_frames.frames(watched.scenario, worst.tolist(), buffers=False)
    tiles = [
        _tile(coded(frame, watched.scenario, cv2.IMREAD_COLOR), watched, i)
        for i, frame in zip(worst.tolist(), shown, strict=True)
    ]
    return np.asarray(preview.sheet(tiles), np.uint8)


def _tile(picture: Picture, watched: Watched, index: int) -> Picture:
    """Mark the true centre (cross) and the found one (circle) on a reduced picture and on an enlarged part of it."""
    true, found = watched.centre[index], watched.seen.pixels[index]
    close = cv2.resize(
        cv2.getRectSubPix(picture, (_INSET_PX, _INSET_PX), np.clip(true, -1e4, 1e4).tolist()),
        None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_NEAREST,
    )  # fmt: skip
    _mark(close, true, found, _ZOOM, true - _INSET_PX / 2)
    scale = preview.TILE_WIDTH / picture.shape[1]
    tile = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _mark(tile, true, found, scale, np.zeros(2))
    size = min(len(close), len(tile))
    tile[-size:, -size:] = close[:size, :size]
    return np.asarray(preview.captioned(tile, _caption(watched, index)), np.uint8)


def _mark(picture: Picture, true: Array, found: Array, scale: float, corner: Array) -> None:
    def at(pixel: Array) -> tuple[int, int]:
        u, v = np.clip((pixel - corner) * scale - 0.5, -9999, 9999).round()
        return int(u), int(v)

    if np.isfinite(true).all():
        cv2.drawMarker(picture, at(true), _TRUE, cv2.MARKER_TILTED_CROSS, 12, 1, cv2.LINE_AA)
    if np.isfinite(found).all():
        cv2.circle(picture, at(found), 7, _FOUND, 1, cv2.LINE_AA)


def _caption(watched: Watched, index: int) -> str:
    observation: Observation = watched.seen.observations[index]
    alpha, rope_m = np.degrees(watched.truth[0, index]), watched.truth[2, index]
    length = watched.seen.rope.length[index]
    centre = f"centre off by {watched.off_px[index]:.1f} px" if observation.centre else observation.missed
    if not watched.present[index]:
        centre = f"no grab there: {'found one' if observation.centre else 'none found'}"
    read = f"read {length:.2f}" if np.isfinite(length) else observation.rope_reason or "no display"
    return f"#{index}  {centre}   alpha {alpha:.2f} deg   rope {rope_m:.2f} m, {read}"
