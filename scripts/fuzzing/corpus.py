"""Sound files of every kind, made by simgrab itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.estimate.follow import Known
from simgrab.instrument.run import runs
from simgrab.instrument.run.run import measure
from simgrab.instrument.source import camera_beside, fitting, open_source
from simgrab.model import calibration, scenes
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

DATASET, VIDEO, RUN, RUN_OF_VIDEO, TILT, RECORD = (
    "dataset",
    "swing.mp4",
    "run",
    "run-of-video",
    "tilt.toml",
    "record.csv",
)
CAMERA = f"{DATASET}/camera.toml"
WIDTH, HEIGHT = 480, 270
_SMALL = {
    "camera.width_px": WIDTH, "camera.height_px": HEIGHT, "camera.focal": {"model": "pixels", "focal_length_px": 411.2},
    "image.samples": 0, "image.shadow_map_px": 0, "place": {"model": "plain"}, "display.layout": "two-by-four",
}  # fmt: skip
FRAMES, FILMED = 6, 12


class _Steady:
    """An instrument that returns a measurement of every status, without using the picture."""

    name = "steady"

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:  # noqa: ARG002
        """Measure a record."""
        return [self._one(i, frame) for i, frame in enumerate(frames)]

    def _one(self, i: int, frame: Frame) -> Measurement:
        if frame.picture is None:
            return Measurement(status="lost", reason=frame.reason)
        if i % 4 == 3:
            return Measurement(status="missed", reason="no grab found")
        return Measurement(
            status="ok", alpha=0.18, alpha_low=0.17, alpha_high=0.2, danger=0.9, box=(100.0, 80.0, 190.0, 160.0),
            score=0.9,
            centre=(145.0 + i, 120.0 - i), centre_sd=(1.0, 1.0), rope_text="1500 1600", rope_status="read",
            rope_length_m=15.0,
        )  # fmt: skip


def make(folder: Path) -> Path:
    """Render a small dataset and a video into a new folder, and measure them; returns the folder."""
    from simgrab.dataset.render import render
    from simgrab.dataset.video.render import render_video

    render(scenes.load("quay-day", _SMALL | {"frames": FRAMES}), folder / DATASET)
    render_video(scenes.load("free-swing", _SMALL | {"frames": FILMED}), folder / VIDEO)
    for source, run in ((DATASET, RUN), (VIDEO, RUN_OF_VIDEO)):
        _measured(folder / source, folder / run)
    covariance = tuple(tuple(row) for row in np.diag([1e-4, 1e-4, 1e-2, 1e-2]).tolist())
    tilt = Known("rope-aware", FRAMES, 3.0, 10.0, (0.0, 0.6, -0.3), covariance)
    (folder / TILT).write_text(tilt.to_toml(), encoding="utf-8")
    (folder / RECORD).write_text(_record(), encoding="utf-8")
    return folder


def _measured(source: Path, out: Path) -> None:
    camera = calibration.load(camera_beside(source))
    opened = open_source(source)
    found = measure(fitting(iter(opened), camera), camera, _Steady(), source=opened.name)
    out.mkdir()
    runs.save(found, out)


def _record() -> str:
    rows = "".join(f"{u:.2f},{v:.2f},{rope:.2f},{t:.3f}\n" for (u, v), rope, t in zip(*_swing(40), strict=True))
    return f"u_px,v_px,rope_length_m,time_s\n{rows}"


def _swing(n: int) -> tuple[Array, Array, Array]:
    time = np.arange(n) / 9.0
    phase = np.sqrt(9.81 / 15) * time
    pixels = 411.2 * np.deg2rad(3) * np.stack([np.cos(phase), 0.5 * np.sin(phase)], axis=-1) + (
        WIDTH / 2 + 5,
        HEIGHT / 2,
    )
    return pixels, 15 + 3 * np.cos(time / 2), time
