"""Frozen values passed between rooms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_args, get_type_hints

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.geometry import Array

SPLITS = ("train", "val", "test")
KEYPOINT_NAMES = (
    "grab_centre",
    "rope_exit",
    "termination_1",
    "termination_2",
    "termination_3",
    "termination_4",
    "lip_outer_1",
    "lip_outer_2",
    "lip_inner_1",
    "lip_inner_2",
)


# What fits into a row of labels, of any dataset that simgrab can write. NaN and infinity do not.
Finite = Annotated[float, msgspec.Meta(ge=-1e12, le=1e12)]
Length = Annotated[float, msgspec.Meta(gt=0, le=1e12)]
Angle = Annotated[float, msgspec.Meta(ge=0, le=180)]
Index = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Side = Annotated[int, msgspec.Meta(ge=1, le=16_384)]
Split = Annotated[str, msgspec.Meta(pattern=f"^({'|'.join(SPLITS)})$")]
Vector = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=3, max_length=3)]
Corners = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=8, max_length=8)]
Pose = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=12, max_length=12)]
Points = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=30, max_length=30)]


def _column(unit: str, text: str) -> msgspec.Meta:
    return msgspec.Meta(description=text, extra={"unit": unit})


class Truth(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One row of labels: what is known of one frame, because it was set. Field by field in `columns`."""

    frame: Annotated[Index, _column("", "index of the frame within the dataset, from 0")]
    split: Annotated[Split, _column("", "train, val or test, by seeded draw")]
    file: Annotated[str, _column("", "picture, relative to the dataset")]
    seed: Annotated[Index, _column("", "seed of the scenario")]
    variant: Annotated[
        Index, _column("", "index of the draw of all that varies within the dataset; 0 where nothing does")
    ]
    varied: Annotated[str, _column("", "what that draw gave, as JSON by factor; empty where nothing varies")]
    clip: Annotated[Index | None, _column("", "index of the clip that the frame is of; empty for independent frames")]
    time_s: Annotated[Finite | None, _column("s", "time within the clip; empty for independent frames")]
    alpha_deg: Annotated[Angle, _column("deg", "swing angle: between OA and gravity, never truncated")]
    gamma_deg: Annotated[
        Finite,
        _column("deg", "azimuth of the swing minus tilt azimuth, counter-clockwise from above, [0, 360)"),
    ]
    beta_deg: Annotated[Angle, _column("deg", "tilt: angle between the optical axis and gravity")]
    tilt_azimuth_deg: Annotated[
        Finite, _column("deg", "direction of the optical axis' horizontal part in the jib frame, [0, 360)")
    ]
    roll_deg: Annotated[Finite, _column("deg", "turn of the camera about its optical axis, (-180, 180]")]
    offset_x_m: Annotated[Finite, _column("m", "camera centre minus rope exit O, jib frame, outboard")]
    offset_y_m: Annotated[Finite, _column("m", "camera centre minus rope exit O, jib frame, sideways")]
    offset_z_m: Annotated[Finite, _column("m", "camera centre minus rope exit O, jib frame, up")]
    rope_length_m: Annotated[Finite, _column("m", "|OA|, from the rope exit to the grab's origin")]
    slew_deg: Annotated[
        Finite, _column("deg", "turn of the jib from the middle of the place, counter-clockwise from above")
    ]
    radius_m: Annotated[
        Finite | None, _column("m", "from the slewing axis to O, which luffing changes; empty for independent frames")
    ]
    apparent_gravity: Annotated[
        Vector,
        _column("m/s2", "gravity less the acceleration of O, jib frame (3): what the grab swings about"),
    ]
    yaw_deg: Annotated[Finite, _column("deg", "turn of the grab about its rope, 0 = x outboard, (-180, 180]")]
    jaw_deg: Annotated[Finite, _column("deg", "opening of each shell about its hinge, 0 = closed")]
    load: Annotated[Finite, _column("", "fill of the closed grab, 0 to 1; an open grab holds nothing")]
    present: Annotated[
        bool,
        _column(
            "", "whether the grab is there; else its pose is where it would be, and it has neither box nor keypoint"
        ),
    ]
    distance_m: Annotated[Finite, _column("m", "from the camera centre to the grab centre A")]
    width_px: Annotated[Side, _column("px", "width of the picture")]
    height_px: Annotated[Side, _column("px", "height of the picture")]
    fx_px: Annotated[Length, _column("px", "focal length, the paper's h")]
    fy_px: Annotated[Length, _column("px", "focal length, equal to fx_px")]
    cx_px: Annotated[Finite, _column("px", "principal point; (0, 0) is the outer corner of the top-left pixel")]
    cy_px: Annotated[Finite, _column("px", "principal point")]
    k1: Annotated[Finite, _column("", "Brown-Conrady radial distortion, OpenCV order and signs")]
    k2: Annotated[Finite, _column("", "radial distortion")]
    p1: Annotated[Finite, _column("", "tangential distortion")]
    p2: Annotated[Finite, _column("", "tangential distortion")]
    k3: Annotated[Finite, _column("", "radial distortion")]
    jib_from_camera: Annotated[Pose, _column("m", "camera pose: upper 3x4 of the transform, row by row (12)")]
    jib_from_grab: Annotated[Pose, _column("m", "grab pose: upper 3x4 of the transform, row by row (12)")]
    grab_u_px: Annotated[
        Finite | None, _column("px", "grab centre A where the picture has it; empty behind the camera")
    ]
    grab_v_px: Annotated[Finite | None, _column("px", "grab centre A where the picture has it")]
    ideal_u_px: Annotated[Finite | None, _column("px", "grab centre A without lens distortion")]
    ideal_v_px: Annotated[Finite | None, _column("px", "grab centre A without lens distortion")]
    m_px: Annotated[Finite | None, _column("px", "distance of the ideal grab centre from the principal point")]
    theta_deg: Annotated[
        Finite | None,
        _column("deg", "its angle from C'G', G' being the image of the vertical, clockwise, (-180, 180]"),
    ]
    box_x0_px: Annotated[Index | None, _column("px", "tight box of the visible grab, half open; empty when unseen")]
    box_y0_px: Annotated[Index | None, _column("px", "visible box, top")]
    box_x1_px: Annotated[Index | None, _column("px", "visible box, right edge")]
    box_y1_px: Annotated[Index | None, _column("px", "visible box, bottom edge")]
    amodal_x0_px: Annotated[
        Finite | None, _column("px", "box of the whole silhouette, hidden and out-of-frame parts included")
    ]
    amodal_y0_px: Annotated[Finite | None, _column("px", "amodal box, top")]
    amodal_x1_px: Annotated[Finite | None, _column("px", "amodal box, right edge")]
    amodal_y1_px: Annotated[Finite | None, _column("px", "amodal box, bottom edge")]
    visible_fraction: Annotated[Finite, _column("", "pixels of the grab seen over pixels of its whole silhouette")]
    in_frame_fraction: Annotated[Finite, _column("", "share of the whole silhouette that lies in the picture")]
    weather_hidden_fraction: Annotated[
        Finite, _column("", "share of the visible grab's light that weather keeps from the camera")
    ]
    oriented_box: Annotated[
        Corners | None,
        _column(
            "px",
            "corners u0, v0 ... u3, v3 of the smallest rotated rectangle around the whole silhouette (8)",
        ),
    ]
    keypoints: Annotated[
        Points,
        _column("px", "u, v, visibility (0 out of the picture, 1 hidden, 2 seen) of each named point in turn (30)"),
    ]
    rope_text: Annotated[str | None, _column("", "rope length digits on the display, above the row where it tore")]
    rope_text_below: Annotated[str | None, _column("", "digits below that row; the same where nothing tore")]
    torn_row_px: Annotated[Index | None, _column("px", "first row that shows the new digits; empty where nothing tore")]
    clock_text: Annotated[str | None, _column("", "date, weekday and clock on the display")]
    image_sha256: Annotated[str, _column("", "digest of the picture file")]


def columns() -> dict[str, tuple[str, str]]:
    """Name of every label column, in order, with its unit and description."""
    result: dict[str, tuple[str, str]] = {}
    for name, hint in get_type_hints(Truth, include_extras=True).items():
        meta = get_args(hint)[-1]
        assert meta.extra is not None
        assert meta.description is not None
        result[name] = (str(meta.extra["unit"]), meta.description)
    return result


@dataclass(frozen=True)
class Intervals:
    """Intervals at one level, by one way of counting what the frames know. Radians; leading axes as in the estimate.

    Attributes
    ----------
    kind : str
        ``"iid"``: frames are independent. ``"blocks"``: only blocks of seconds are. ``"posterior"``: by a model of
        the motion.
    level : float
        Nominal coverage.
    beta, sigma : ndarray, shape (..., 2), or None
        Lower and upper end; None (NaN within a batch) where none can be given, and then `note` says why.
    alpha : ndarray, shape (..., n, 2), or None
        Of each frame, given the pixel: what the tilt's (and offset's) uncertainty does to α.
    blocks : int or None
        How many blocks.
    note : str
        Why there is none, or what it takes for granted; empty otherwise.
    tilt : ndarray, shape (..., 2, 2) or (..., 4, 4), or None
        Covariance, rad², of gravity along and across the tilt and, where the offset is estimated, of minus its
        horizontal part in the same two directions, m²; what frames to come need.
    """

    kind: str
    level: float
    beta: Array | None
    sigma: Array | None
    alpha: Array | None
    blocks: int | None = None
    note: str = ""
    tilt: Array | None = None


def _of_kind(intervals: tuple[Intervals, ...], kind: str) -> Intervals:
    for interval in intervals:
        if interval.kind == kind:
            return interval
    raise KeyError(f"no {kind!r} intervals; there are: {', '.join(i.kind for i in intervals) or 'none'}")


@dataclass(frozen=True)
class Estimate:
    """What an estimator found in one record of n frames, or why it refused. Radians, metres, jib frame.

    Attributes
    ----------
    estimator : str
        Its name in the registry.
    status : str
        ``"ok"`` or ``"refused"``.
    reason : str
        Of a refusal; empty when ok.
    frames : int
        How many frames were used; rows without a finite pixel are missing frames.
    beta, tilt_azimuth, sigma : float or None
        Tilt, direction of the optical axis' horizontal part in [0, 2π), √E[α²]; None when refused.
    alpha : ndarray, shape (n,), or None
        Swing of each frame, NaN where the frame is missing; None when refused.
    offset : ndarray, shape (3,), or None
        Camera centre minus rope exit, m, where it was estimated.
    intervals : tuple of Intervals
        One for each way of counting.
    diagnostics : mapping
        What the estimator has to say about its own work: iterations, history, concentration, …
    """

    estimator: str
    status: str
    reason: str
    frames: int
    beta: float | None
    tilt_azimuth: float | None
    sigma: float | None
    alpha: Array | None
    offset: Array | None
    intervals: tuple[Intervals, ...]
    diagnostics: Mapping[str, Any]

    @property
    def ok(self) -> bool:
        """Whether there is a result."""
        return self.status == "ok"

    def interval(self, kind: str) -> Intervals:
        """Find the intervals of one kind; raises KeyError naming those there are."""
        return _of_kind(self.intervals, kind)


@dataclass(frozen=True)
class Estimates:
    """The estimates of M records of n frames each, as arrays; ``estimates[i]`` is the `Estimate` of one.

    Attributes
    ----------
    estimator : str
    ok : ndarray of bool, shape (M,)
    reason : ndarray of str, shape (M,)
        Why a record was refused; empty where ok.
    frames : ndarray of int, shape (M,)
    beta, tilt_azimuth, sigma : ndarray, shape (M,)
        NaN where not ok. Count the refusals before you average over the rest.
    alpha : ndarray, shape (M, n)
    offset : ndarray, shape (M, 3), or None
    intervals : tuple of Intervals
    diagnostics : mapping of str to ndarray, shape (M, ...)
    """

    estimator: str
    ok: NDArray[np.bool_]
    reason: NDArray[np.str_]
    frames: NDArray[np.int64]
    beta: Array
    tilt_azimuth: Array
    sigma: Array
    alpha: Array
    offset: Array | None
    intervals: tuple[Intervals, ...]
    diagnostics: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.ok)

    def interval(self, kind: str) -> Intervals:
        """Find the intervals of one kind; raises KeyError naming those there are."""
        return _of_kind(self.intervals, kind)

    def __getitem__(self, i: int) -> Estimate:
        ok = bool(self.ok[i])

        def one(interval: Intervals) -> Intervals:
            beta, sigma, alpha, tilt = (
                None if a is None or bool(np.isnan(a[i]).all()) else a[i]
                for a in (interval.beta, interval.sigma, interval.alpha, interval.tilt)
            )
            note = interval.note
            if sigma is None and not note:
                note = "no scatter to judge by: the frames are identical"
            return Intervals(interval.kind, interval.level, beta, sigma, alpha, interval.blocks, note, tilt)

        return Estimate(
            estimator=self.estimator,
            status="ok" if ok else "refused",
            reason=str(self.reason[i]),
            frames=int(self.frames[i]),
            beta=float(self.beta[i]) if ok else None,
            tilt_azimuth=float(self.tilt_azimuth[i]) if ok else None,
            sigma=float(self.sigma[i]) if ok else None,
            alpha=self.alpha[i] if ok else None,
            offset=self.offset[i] if ok and self.offset is not None else None,
            intervals=tuple(one(interval) for interval in self.intervals) if ok else (),
            diagnostics={name: value[i] for name, value in self.diagnostics.items()},
        )


@dataclass(frozen=True)
class Detection:
    """What a detector found in one picture, or why it found nothing. Pixels: (0, 0) is the corner of the top-left one.

    Attributes
    ----------
    status : str
        ``"found"`` or ``"none"``.
    reason : str
        Of there being none; empty when found.
    score : float
        From 0 to 1; of the best candidate where none was good enough, 0 where there was no candidate.
    box : ndarray, shape (4,), or None
        x0, y0, x1, y1 of the visible grab, within the picture; None unless found.
    centre : ndarray, shape (2,), or None
        Where the picture has the grab centre A, which is not the centre of the box; None where the detector tells none.
    yaw : float or None
        Direction of the grab's x axis in the picture at A, clockwise from the picture's x axis, rad, in [0, π): the
        grab looks alike turned by half a turn.
    box_sd_px : ndarray, shape (4,), or None
    centre_sd_px : ndarray, shape (2,), or None
    yaw_sd : float or None
        Standard deviations; ±1.96 of them are meant to cover 95 %.
    """

    status: str
    reason: str
    score: float
    box: Array | None = None
    centre: Array | None = None
    yaw: float | None = None
    box_sd_px: Array | None = None
    centre_sd_px: Array | None = None
    yaw_sd: float | None = None

    @property
    def found(self) -> bool:
        """Whether there is a grab."""
        return self.status == "found"


@dataclass(frozen=True)
class Reading:
    """What a reader made of the rope lengths on the display in one picture, or why it refused.

    Attributes
    ----------
    status : str
        ``"read"``, ``"refused"``, or ``"jump"``: read, but the rope cannot have got there since the readings around it.
    reason : str
        Of a refusal or jump; empty when read.
    hoist_text, closing_text : str
        As the display writes them, with ``?`` for a digit that was refused.
    confidence : ndarray, shape (8,)
        Of each digit, 0 to 1: hoist rope, then closing rope, from left to right.
    hoist_m, closing_m : float or None
        Lengths on the display; None when refused.
    rope_length_m : float or None
        |OA|: hoist rope plus the display's constant; None unless read.
    """

    status: str
    reason: str
    hoist_text: str
    closing_text: str
    confidence: Array
    hoist_m: float | None
    closing_m: float | None
    rope_length_m: float | None

    @property
    def ok(self) -> bool:
        """Whether it is to be believed."""
        return self.status == "read"

    @property
    def text(self) -> str:
        """Both numbers, as in the label column ``rope_text``."""
        return f"{self.hoist_text} {self.closing_text}"
