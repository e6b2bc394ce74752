"""Measure the foreign exam's clips by the bundled instrument, compare with the truth, and write what comes out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scripts.foreign.clips import CLIPS, FOREIGN, MUJOCO, Clip, Setting, missing_frames, scenario_of, video
from scripts.foreign.scoring import TILE_PX
from scripts.foreign.tables import DASH, markdown
from simgrab.instrument.pipeline import assemble
from simgrab.instrument.run.run import run
from simgrab.instrument.run.runs import Run
from simgrab.instrument.source import open_source
from simgrab.judge.evaluate import truths
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.judge.evaluate.truths import Truths
from simgrab.model import label_arrays as labels

BY = {MUJOCO: "MuJoCo", FOREIGN: "Blender"}
GREEN, RED, WHITE = (60, 220, 60), (60, 60, 255), (255, 255, 255)
COLUMNS = 4
HEADS = (
    "clip", "by", "grab found", "frames with an angle", "α̂: RMSE, bias", "95 % intervals hold",
    "events beyond 10.5°: found, missed", "alarms, false", "β̂ − β", "digits right of those read, refused",
)  # fmt: skip


def measure(
    folder: Path, clip: Clip, setting: Setting, detector: str
) -> tuple[dict[str, Any], list[NDArray[np.uint8]]]:
    """Measure a clip's videos, as far as they are there, as ``simgrab run`` does.

    Returns
    -------
    dict
        ``frames`` of the clip and how many of Blender's are ``missing``; ``beta_deg``, the true tilt; ``by``: figures
        of each video, see `figures`. None of a clip that is not begun.
    list of ndarray
        For each video a strip of some of its frames, BGR: the box of the truth in green, the detected one in red.
    """
    where, strips = folder / clip.time, list[NDArray[np.uint8]]()
    found: dict[str, Any] = {
        "motion": clip.motion, "coder": clip.coder if "coder" in setting.replaced else "h264",
        "frames": setting.frames, "missing": len(missing_frames(where, setting.frames)), "by": {},
    }  # fmt: skip
    for by in BY:
        if video(where, by).exists() and video(where, MUJOCO).exists():
            found["beta_deg"] = scenario_of(clip, setting, where).camera.beta_deg
            measured = run(video(where, by), instrument=assemble(detector=detector))
            known = truths.of(measured, video(where, MUJOCO))
            found["by"][by] = figures(measured, known, found["beta_deg"])
            strips.append(strip(video(where, by), measured, known))
    return found, strips


def figures(measured: Run, known: Truths, beta_deg: float) -> dict[str, Any]:
    """Figures of one video.

    Returns
    -------
    dict
        ``evaluation`` as ``simgrab evaluate --json`` prints it; ``beta_error_deg``, None without an estimate;
        ``failure``; and of each frame ``time_s``, the ``true_deg`` and the measured ``alpha_deg``.
    """
    beta = (measured.about["estimate"] or {}).get("beta_deg")
    assert measured.time is not None
    return {
        "evaluation": evaluate(measured, known).to_dict(),
        "beta_error_deg": None if beta is None else beta - beta_deg,
        "failure": measured.failure,
        "time_s": measured.time.tolist(),
        "true_deg": _plain(np.rad2deg(known.alpha)),
        "alpha_deg": _plain(np.rad2deg(measured.alpha)),
    }


def _plain(values: NDArray[np.float64]) -> list[float | None]:
    return [round(float(value), 4) if np.isfinite(value) else None for value in values]


def table(clips: Mapping[str, Any]) -> str:
    """Markdown of what `measure` gives, by clip; it states what is missing."""
    lines, missing = [], []
    for clip in (clip for clip in CLIPS if clip.time in clips):
        found = clips[clip.time]
        for by, name in BY.items():
            cells = _cells(found["by"][by]) if by in found["by"] else [DASH] * (len(HEADS) - 2)
            lines.append((clip.time if by == MUJOCO else "", name, *cells))
        if FOREIGN not in found["by"]:
            missing.append(f"{clip.time} ({found['missing']} of {found['frames']} frames by Blender are missing)")
    parts = [markdown(HEADS, lines)]
    parts += [
        f"{clip.time}: the crane {clips[clip.time]['motion']}; Blender's video is coded as {clips[clip.time]['coder']}."
        for clip in CLIPS
        if clip.time in clips
    ]
    if missing:
        parts.append(f"\nNot complete: {', '.join(missing)}.")
    return "\n".join(parts) + "\n"


def _cells(found: Mapping[str, Any]) -> list[str]:
    one = found["evaluation"]
    detection, angle, interval, alarm, reading = (
        one[part] for part in ("detection", "angle", "interval", "alarm", "reading")
    )
    overall = angle["overall"]
    return [
        _hits(detection) if detection["labelled"] else DASH,
        f"{one['frames']['ok']} of {one['frames']['all']}",
        f"{overall['rmse_deg']:.2f}°, {overall['bias_deg']:+.2f}°" if overall["frames"] else DASH,
        f"{100 * interval['share']:.0f} %" if interval["frames"] else DASH,
        f"{alarm['sure'] - alarm['missed']}, {alarm['missed']}" if alarm else DASH,
        f"{alarm['reported']}, {alarm['false']}" if alarm else DASH,
        DASH if found["beta_error_deg"] is None else f"{found['beta_error_deg']:+.2f}°",
        _digits(reading) if reading else DASH,
    ]


def _hits(detection: Mapping[str, Any]) -> str:
    return f"{round(detection['recall'] * detection['labelled'])} of {detection['labelled']}"


def _digits(reading: Mapping[str, Any]) -> str:
    right, refused = reading["digits_right"], reading["digits_refused"]
    return f"{right['count']} of {right['of']}, {refused['count']}"


def strip(path: Path, measured: Run, known: Truths) -> NDArray[np.uint8]:
    """Show `COLUMNS` frames of a video side by side, as decoded, with boxes and angles, true and measured."""
    chosen = {round(n) for n in np.linspace(0, len(known.rows) - 1, COLUMNS)}
    tiles = []
    for number, frame in enumerate(open_source(path)):
        if number in chosen and frame.picture is not None:
            picture = np.ascontiguousarray(frame.picture[..., ::-1])
            row, one = known.rows[number], measured.measurements[number]
            for box, colour in ((None if row is None else labels.box(row), GREEN), (one.box, RED)):
                if box is not None:
                    x0, y0, x1, y1 = (round(float(side)) for side in box)
                    cv2.rectangle(picture, (x0, y0), (x1, y1), colour, max(picture.shape[1] // 480, 1))
            tile = cv2.resize(picture, TILE_PX, interpolation=cv2.INTER_AREA)
            true, angle = np.degrees(known.alpha[number]), np.degrees(measured.alpha[number])
            text = f"{frame.time_s:.1f} s: {true:.1f} deg, measured {angle:.1f} ({one.status})"
            cv2.rectangle(tile, (0, TILE_PX[1] - 20), TILE_PX, (0, 0, 0), cv2.FILLED)
            place = (8, TILE_PX[1] - 6)
            cv2.putText(tile, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, WHITE, 1, cv2.LINE_AA)
            tiles.append(np.asarray(tile, np.uint8))
    tiles += [np.zeros((TILE_PX[1], TILE_PX[0], 3), np.uint8)] * (COLUMNS - len(tiles))
    return np.concatenate(tiles, axis=1)


def sheet(strips: Sequence[NDArray[np.uint8]]) -> bytes:
    """Put strips below each other, as JPEG."""
    _, data = cv2.imencode(".jpg", np.concatenate(strips), [cv2.IMWRITE_JPEG_QUALITY, 88])
    return data.tobytes()
