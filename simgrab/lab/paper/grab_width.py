"""The paper's validation by grab width (section 4.6), on rendered frames, and why it validates nothing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.errors import DatasetError, first_line
from simgrab.instrument.estimate import PaperIteration
from simgrab.io.parquet import read_table
from simgrab.model import calibration as camera_file
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, eq2_cos_alpha, vertical_direction
from simgrab.model.truth import KEYPOINT_NAMES
from simgrab.world.scenery.grabs.four_rope import four_rope

_COLUMNS = ("alpha_deg", "beta_deg", "yaw_deg", "jaw_deg", "rope_length_m", "grab_u_px", "grab_v_px", "keypoints")


def swing_by_width(m_px: ArrayLike, width_px: ArrayLike, rope_length: ArrayLike, width_m: float = 2.9) -> Array:
    """α̃ = arcsin(m·b/(x·l)), which x·l·cosα = h·b and tanα = m/h give for β = 0 (section 4.6).

    It does not use the tilt. For a camera at the rope exit it is, up to the width's own error, the angle ψ of
    the ray from the optical axis, so that |ψ − α̂| ≤ β̂ holds by the triangle inequality for any β̂, right or wrong:
    this check cannot fail.

    Parameters
    ----------
    m_px : array_like, shape (n,)
        m, distance of the grab centre from the principal point, undistorted.
    width_px : array_like, shape (n,)
        x, the apparent width of the grab.
    rope_length : array_like, shape (n,)
        l, m.
    width_m : float
        b, the grab's width; the paper's by default.

    Returns
    -------
    ndarray, shape (n,)
        Radians; NaN where the arcsine has no value.
    """
    m, x, rope = (np.asarray(v, float) for v in (m_px, width_px, rope_length))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = m * width_m / (x * rope)
        return np.asarray(np.arcsin(np.where(np.abs(ratio) <= 1, ratio, np.nan)))


@dataclass(frozen=True)
class GrabWidthStudy:
    """The paper's comparison on k frames that it would have picked; angles in radians, shape (k,)."""

    frames: NDArray[np.int64]  # rows that were picked: grab closed, unturned, nearest to the centre
    by_width: Array  # α̃
    estimated: Array  # α̂
    truth: Array  # α
    axis_angle: Array  # ψ, the angle of the ray from the optical axis
    beta: float  # β̂ from all frames
    true_beta: float
    wrong: tuple[tuple[float, float, float], ...]  # made-up tilts, the largest |ψ − α̂| of each, and error of α̂


def study(dataset: str | Path, frames: int = 40, turned_deg: float = 10.0) -> GrabWidthStudy:
    """Compare α̃ with α̂ on a rendered dataset.

    Parameters
    ----------
    dataset : path
        Folder with ``labels.parquet`` and ``camera.toml``.
    frames : int
        How many to pick; the paper has 40.
    turned_deg : float
        A grab turned by more is not picked.

    Raises
    ------
    DatasetError
        If there are too few such frames.
    """
    folder = Path(dataset)
    labels = folder / "labels.parquet"
    table = read_table(labels, DatasetError, columns=_COLUMNS).to_pydict()
    try:
        column = {name: np.asarray(values, float) for name, values in table.items() if name != "keypoints"}
    except (TypeError, ValueError) as problem:
        raise DatasetError(f"{labels}: not simgrab labels ({first_line(problem)})") from None
    calibration = camera_file.load(folder / "camera.toml")
    pixels = np.stack([column["grab_u_px"], column["grab_v_px"]], axis=-1)
    found = PaperIteration(start="mean-ray").estimate(pixels, calibration)
    if found.alpha is None or found.beta is None or found.tilt_azimuth is None:
        raise DatasetError(f"{folder}: no tilt to compare with: {found.reason}")

    ideal = calibration.intrinsics.undistort(pixels)
    m = calibration.intrinsics.polar(ideal)[0]
    unturned = np.abs((column["yaw_deg"] + 90) % 180 - 90) <= turned_deg
    good = np.flatnonzero(unturned & (column["jaw_deg"] == 0) & np.isfinite(m))
    picked = np.sort(good[np.argsort(m[good], kind="stable")][:frames])
    if len(picked) < frames:
        raise DatasetError(f"{folder}: {len(picked)} frames show a closed grab turned by less than {turned_deg:g} deg")

    width_m, drop = _lip()
    seen = _lip_width_px(np.array([table["keypoints"][i] for i in picked], float), calibration)
    by_width = swing_by_width(m[picked], seen, column["rope_length_m"][picked] + drop, width_m)
    truth = np.deg2rad(column["alpha_deg"][picked])
    axis = float(vertical_direction(found.tilt_azimuth, np.deg2rad(calibration.roll_deg)))
    theta = calibration.intrinsics.polar(ideal[picked], axis)[1]
    psi = np.arctan2(m[picked], calibration.focal_length_px)
    wrong = []
    for tilt in np.deg2rad([0.0, 1.0, 2.0, 5.0, 10.0, 20.0]):
        alpha = np.arccos(np.clip(eq2_cos_alpha(m[picked], theta, tilt, calibration.focal_length_px), -1, 1))
        wrong.append((float(tilt), float(np.abs(psi - alpha).max()), float(np.abs(alpha - truth).max())))
    return GrabWidthStudy(
        frames=picked,
        by_width=by_width,
        estimated=found.alpha[picked],
        truth=truth,
        axis_angle=psi,
        beta=found.beta,
        true_beta=float(np.deg2rad(column["beta_deg"][0])),
        wrong=tuple(wrong),
    )


def summary_lines(result: GrabWidthStudy) -> list[str]:
    """Summarise the study in lines of text."""
    difference = np.rad2deg(np.abs(result.by_width - result.estimated))
    error, other = (np.rad2deg(np.abs(a - result.truth)) for a in (result.by_width, result.estimated))
    beta = np.rad2deg(result.beta)
    lines = [
        f"{len(result.frames)} frames; tilt {np.rad2deg(result.true_beta):.2f} deg, estimated {beta:.2f} deg",
        f"|by width - estimated|: median {np.median(difference):.2f}, largest {difference.max():.2f} deg; "
        f"{np.sum(difference < 2)} below 2 deg (the paper: all 40)",
        f"but against the truth: by width {error.max():.2f} deg at most, estimated {other.max():.2f}",
        "the check with tilts made up, on the same frames:",
    ]
    lines += [
        f"  tilt {np.rad2deg(tilt):4.1f} deg: |psi - alpha| at most {np.rad2deg(bound):5.2f} deg, so it passes; "
        f"alpha wrong by up to {np.rad2deg(wrong):5.2f} deg"
        for tilt, bound, wrong in result.wrong
    ]
    return lines


def _lip() -> tuple[float, float]:
    """Width of the closed grab's cutting lip, and how far it lies below A along the rope, m."""
    grab = four_rope()
    pose = grab.frames(0.0)["shell_outer"]
    one, other = (pose[:3, :3] @ p + pose[:3, 3] for p in grab.lips["shell_outer"])
    return float(np.linalg.norm(one - other)), float(-one[2])


def _lip_width_px(keypoints: Array, calibration: Calibration) -> Array:
    """Distance between the corners of the outer lip, undistorted, shape (k,)."""
    points = keypoints.reshape(len(keypoints), len(KEYPOINT_NAMES), 3)[..., :2]
    ideal = calibration.intrinsics.undistort(points)
    ends = (ideal[:, KEYPOINT_NAMES.index(name)] for name in ("lip_outer_1", "lip_outer_2"))
    one, other = ends
    return np.asarray(np.linalg.norm(one - other, axis=-1))
