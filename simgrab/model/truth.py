"""A row of labels."""

from __future__ import annotations

from typing import Annotated, get_args, get_type_hints

import msgspec

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
Split = Annotated[str, msgspec.Meta(pattern=rf"^({'|'.join(SPLITS)})\Z")]
Vector = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=3, max_length=3)]
Corners = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=8, max_length=8)]
Pose = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=12, max_length=12)]
Points = Annotated[tuple[Finite, ...], msgspec.Meta(min_length=30, max_length=30)]


def _column(unit: str, text: str) -> msgspec.Meta:
    return msgspec.Meta(description=text, extra={"unit": unit})


class Truth(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The truth of one frame. `columns` describes each field."""

    frame: Annotated[Index, _column("", "index of the frame within the dataset, from 0")]
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
    clamped: Annotated[
        str,
        _column(
            "", "keys of the swing, joined by +, that were drawn impossible and replaced (`swing.clamp`); empty if none"
        ),
    ]
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


class Row(Truth, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One row of labels: a frame's truth, and the file that its picture is stored in."""

    split: Annotated[Split, _column("", "train, val or test, by seeded draw")]
    file: Annotated[str, _column("", "picture, relative to the dataset")]
    image_sha256: Annotated[str, _column("", "digest of the picture file")]


class Boxed(msgspec.Struct, frozen=True, kw_only=True):
    """A frame that simgrab did not render: the grab's box is all that is known of it, or that there is none.

    Attributes
    ----------
    frame : int
        Index within the dataset.
    split : str
    file : str
        Picture, relative to the dataset.
    image_sha256 : str
        SHA-256 of the picture file.
    video : str
        Name of the video that the frame is of.
    width_px, height_px : int
        Size of the decoded picture.
    box_x0_px, box_y0_px, box_x1_px, box_y1_px : float or None
        Box of the grab; None where it is not there.
    clip, time_s : None
        Frames of unknown time; see `simgrab.model.records.frame_files.PictureRow`.
    """

    frame: int
    split: str
    file: str
    image_sha256: str
    video: str
    width_px: int
    height_px: int
    box_x0_px: float | None = None
    box_y0_px: float | None = None
    box_x1_px: float | None = None
    box_y1_px: float | None = None
    clip: int | None = None
    time_s: float | None = None


def columns() -> dict[str, tuple[str, str]]:
    """Name of every label column, in the order of ``labels.parquet``, with its unit and description."""
    known: dict[str, tuple[str, str]] = {}
    for name, hint in get_type_hints(Row, include_extras=True).items():
        meta = get_args(hint)[-1]
        assert meta.extra is not None
        assert meta.description is not None
        known[name] = (str(meta.extra["unit"]), meta.description)
    first, last = ("frame", "split", "file"), ("image_sha256",)
    order = [*first, *(name for name in known if name not in first + last), *last]
    return {name: known[name] for name in order}
