"""The rendered fidelity: a replication is a record of pictures, measured by the default detector and reader."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset import preview
from simgrab.errors import SimgrabError, StressError
from simgrab.io.pictures import encode
from simgrab.io.resources import ASSETS
from simgrab.lab.stress import estimators, study, swings
from simgrab.lab.stress.axes import Value
from simgrab.lab.stress.records import PROBE_ALPHA, PROBES, Picture, Records
from simgrab.lab.stress.study import BASE, Study
from simgrab.lab.stress.swings import Draws, ReplicatedMotion
from simgrab.model import label_arrays as arrays
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, camera_rotation, grab_centre, to_camera
from simgrab.model.rng import stream
from simgrab.model.scenario import Iid, Scenario

if TYPE_CHECKING:  # geometric studies do without OpenGL and onnxruntime: what needs them is imported late
    from simgrab.instrument.angles import RecordArrays
    from simgrab.instrument.contract import Frame
    from simgrab.instrument.pipeline import Pipeline
    from simgrab.world.frames import Frame as RenderedFrame

KEYS = (
    BASE, "frames", "camera", "swing", "grab", "jib", "place", "clutter", "light", "optics", "weather", "image",
    "shutter", "clip.frame_rate_hz", "display",
)  # fmt: skip
"""Keys of a scenario, or tables of keys, that pictures and their times depend on; and the scene itself."""

MOST_SHOWN = 8
_INSET_PX, _ZOOM = 100, 2
_TRUE, _FOUND = (40, 40, 255), (60, 220, 60)  # BGR


@dataclass(frozen=True, eq=False)
class Watched:
    """One replication of n frames: observation and truth of each."""

    scenario: Scenario  # under the replication's own seed
    calibration: Calibration  # calibration that the instrument gets
    arrays: RecordArrays
    truth: Array  # (6, n), of the swing α, azimuth (rad) and rope (m), of the camera β, azimuth and roll (rad)
    centre: Array  # (n, 2), where the pictures have the grab centre A, px
    present: NDArray[np.bool_]  # (n,), whether there is a grab

    @property
    def off_px(self) -> Array:
        """From the true to the found centre, shape (n,); NaN where none was found."""
        return np.asarray(np.linalg.norm(self.arrays.pixels - self.centre, axis=-1))


def prepare(chosen: Study, point: tuple[Value, ...]) -> Scenario:
    """Make the scene at a point of a study; raises `StressError` if there is none, or an estimator lacks inputs."""
    scenario = study.scenario(chosen, point)
    if scenario.vary:
        raise StressError(f"{BASE}: {scenario.name!r} varies {next(iter(scenario.vary))}; the base scene must not vary")
    lacks = {
        "needs_rope": "the rope's length, and the scene shows no display to read it from (display.layout)"
        if scenario.display_layout is None else "",
        "needs_time": "times, and the scene's frames are independent (swing.model)"
        if isinstance(scenario.swing, Iid) else "",
    }  # fmt: skip
    for name in chosen.estimators:
        estimator = estimators.find(name)
        for need, why in lacks.items():
            if why and getattr(estimator, need, False):
                raise StressError(f"estimators: {name!r} takes {why}")
    return scenario


def together(scenario: Scenario) -> int:  # noqa: ARG001
    """Return how many replications may be rendered together: one, so that an interrupted run loses little."""
    return 1


def draw(scenario: Scenario, seed: int, trials: Sequence[int]) -> Records:
    """Render and measure. Replication k is the scene under a seed of its own, in a world of its own."""
    return _records(scenario, seed, trials, [watch(scenario, seed, trial) for trial in trials])


def show(scenario: Scenario, seed: int, trial: int) -> tuple[Records, Picture]:
    """Draw one replication, and a sheet of the frames in which the grab is found worst (BGR)."""
    watched = watch(scenario, seed, trial)
    return _records(scenario, seed, [trial], [watched]), _sheet(watched)


def made_with() -> str:
    """Name renderer, detector and reader, by digests."""
    from simgrab.judge.doctor import fingerprint

    weights = hashlib.sha256()
    for path in sorted((ASSETS / "weights").glob("*.onnx")):
        weights.update(path.read_bytes())
    return f"renderer {fingerprint().digest}, weights {weights.hexdigest()[:16]}"


def watch(scenario: Scenario, seed: int, trial: int) -> Watched:
    """Render one replication and observe each frame as the bundled pipeline does, keeping no picture.

    Its frames are one clip under a seed of its own, the same at every point of a study. Raises `StressError` if a frame
    cannot be.
    """
    from simgrab.dataset.tables import calibration_of
    from simgrab.instrument import angles
    from simgrab.instrument.contract import Frame
    from simgrab.instrument.observation import observe
    from simgrab.instrument.rope import rope
    from simgrab.world import frames as world_frames

    own_seed = int(stream(seed, trial, "stress.scene").integers(2**53))
    clip = msgspec.structs.replace(scenario.clip, clip_frames=0)
    own, pipeline = msgspec.structs.replace(scenario, seed=own_seed, clip=clip), _pipeline()
    calibration = calibration_of(own)
    truth: list[tuple[float, ...]] = []

    def frames() -> Iterator[Frame]:
        timed = not isinstance(own.swing, Iid)
        for index, frame in enumerate(world_frames.frames(own, buffers=False)):
            grab, tilt, (u, v) = frame.moment.grab, frame.moment.tilt, arrays.centre(frame.truth)
            swing = grab.alpha, grab.azimuth, grab.rope_length
            truth.append((*swing, tilt.beta, tilt.azimuth, tilt.roll, u, v, float(frame.moment.present)))
            yield Frame(_coded(frame, own, cv2.IMREAD_COLOR_RGB), index / clip.frame_rate_hz if timed else None)

    try:
        observations = tuple(observe(frames(), pipeline.detector, pipeline.reader, calibration))
    except SimgrabError as problem:
        raise StressError(f"replication {trial}: {problem}") from None
    found = angles.arrays(observations, *rope(observations, calibration))
    rows = np.array(truth).T
    return Watched(own, calibration, found, rows[:6], rows[6:8].T, rows[8] > 0)


@functools.cache
def _pipeline() -> Pipeline:
    from simgrab.instrument.pipeline import assemble

    return assemble()


def _coded(frame: RenderedFrame, scenario: Scenario, order: int) -> Picture:
    """Give a picture as a file of it would, in OpenCV's ``order`` of colours."""
    data = encode(frame.rgb[..., ::-1], scenario.image.format, scenario.image.quality)
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), order), np.uint8)


def _records(scenario: Scenario, seed: int, trials: Sequence[int], watched: Sequence[Watched]) -> Records:
    camera, swing = scenario.camera, scenario.swing
    truth = np.stack([one.truth for one in watched])  # (M, 6, n)
    alpha, azimuth, rope = np.moveaxis(truth[:, :3], 1, 0)
    # Of physics, whose expectation nobody knows, the record's own.
    sigma = (
        np.full(len(trials), math.radians(swing.alpha.sigma_deg))
        if isinstance(swing, Iid)
        else np.sqrt(np.mean(alpha**2, axis=-1))
    )
    motion = ReplicatedMotion(alpha, azimuth, rope, truth[:, 3:], sigma)
    ring = swings.ring(Draws(seed, trials, PROBES), motion, PROBE_ALPHA, math.radians(camera.tilt_azimuth_deg))
    assert ring.tilt is not None
    centre = to_camera(
        grab_centre(ring.alpha, ring.azimuth, ring.rope), camera_rotation(*ring.tilt.swapaxes(0, 1)), camera.offset_m
    )
    return Records(
        pixels=np.stack([one.arrays.pixels for one in watched]),
        rope=np.stack([one.arrays.rope_length for one in watched]),
        time=watched[0].arrays.time,
        calibration=watched[0].calibration,
        alpha=np.where([one.present for one in watched], alpha, np.nan),
        beta=math.radians(camera.beta_deg),
        sigma=sigma,
        azimuth=math.radians(camera.tilt_azimuth_deg),
        probe_pixels=camera.intrinsics.project(centre),
        probe_rope=ring.rope,
        pixel_sd=np.stack([one.arrays.pixel_sd for one in watched]),
    )


def _sheet(watched: Watched) -> Picture:
    """Draw the frames again in which the grab was missed, or found farthest from where it is (BGR)."""
    from simgrab.world import frames as world_frames

    off = watched.off_px
    worst = np.argsort(np.where(np.isfinite(off), -off, -np.inf), kind="stable")[:MOST_SHOWN]
    shown = world_frames.frames(watched.scenario, worst.tolist(), buffers=False)
    tiles = []
    for index, frame in zip(worst.tolist(), shown, strict=True):
        tile = _tile(_coded(frame, watched.scenario, cv2.IMREAD_COLOR), watched, index)
        tiles.append(preview.captioned(tile, _caption(watched, index)))
    return np.asarray(preview.sheet(tiles), np.uint8)


def _tile(picture: Picture, watched: Watched, index: int) -> Picture:
    """Mark the true centre (cross) and the found one (circle) on a reduced picture and on an enlarged part of it."""
    true, found = watched.centre[index], watched.arrays.pixels[index]
    close = cv2.resize(
        cv2.getRectSubPix(picture, (_INSET_PX, _INSET_PX), np.clip(true, -1e4, 1e4).tolist()),
        None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_NEAREST,
    )  # fmt: skip
    _mark(close, true, found, _ZOOM, true - _INSET_PX / 2)
    scale = preview.TILE_WIDTH / picture.shape[1]
    tile = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    _mark(tile, true, found, scale, np.zeros(2))
    size = min(len(close), len(tile))
    tile[-size:, -size:] = close[:size, :size]
    return tile


def _mark(picture: Picture, true: Array, detected: Array, scale: float, corner: Array) -> None:
    if np.isfinite(true).all():
        cv2.drawMarker(picture, preview.at(true - corner, scale), _TRUE, cv2.MARKER_TILTED_CROSS, 12, 1, cv2.LINE_AA)
    if np.isfinite(detected).all():
        cv2.circle(picture, preview.at(detected - corner, scale), 7, _FOUND, 1, cv2.LINE_AA)


def _caption(watched: Watched, index: int) -> str:
    observation = watched.arrays.observations[index]
    alpha, rope_m = np.degrees(watched.truth[0, index]), watched.truth[2, index]
    length = watched.arrays.rope_length[index]
    centre = f"centre off by {watched.off_px[index]:.1f} px" if observation.centre else observation.missed
    if not watched.present[index]:
        centre = f"no grab there: {'found one' if observation.centre else 'none found'}"
    read = f"read {length:.2f}" if np.isfinite(length) else observation.rope_reason or "no display"
    return f"#{index}  {centre}   alpha {alpha:.2f} deg   rope {rope_m:.2f} m, {read}"
