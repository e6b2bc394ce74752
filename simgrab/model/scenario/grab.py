"""The grab: its kind, shape and appearance."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Annotated, ClassVar, Literal

from simgrab.errors import ScenarioError
from simgrab.io import models
from simgrab.model.scenario.base import Cargo, File, Meta, OfFile, Rgb, Sha256, Share, Strict, Tagged, about

Point = tuple[float, float, float]
Ratio = Annotated[float, Meta(ge=0.75, le=1.35)]
Shells = Literal["closed", "half", "open"]
Profile = Literal["round", "angular"]
Up = Literal["auto", "x", "y", "z", "-x", "-y", "-z"]
Mass = Annotated[float, Meta(ge=50, le=200_000)]
DragArea = Annotated[float, Meta(ge=0, le=500)]


class GrabAppearance(Tagged, frozen=True):
    """What all grabs have."""

    paint_rgb: Annotated[Rgb, about("Colour of the paint: red, green and blue from 0 to 1.")] = (0.86, 0.52, 0.07)
    wear: Annotated[Share, about("Worn paint and rust: 0 is new.")] = 0.4
    residue: Annotated[Share, about("Cargo that sticks to the grab: 0 is clean.")] = 0.3
    cargo: Annotated[Cargo, about("Cargo that the grab holds and that sticks to it.")] = "coal"


class FourRope(GrabAppearance, frozen=True, tag="four-rope"):
    """A clamshell of fixed shape on four ropes: 10.5 t, 24 t full, 2.9 × 2.4 × 3.4 m closed."""


class Shaped(GrabAppearance, frozen=True):
    """What all parametric grabs have.

    ``width``, ``length`` and ``height`` are relative to the kind's usual proportions, and are scaled together so that
    the volume stays.
    """

    volume_m3: Annotated[float, about("What the closed grab holds.", ge=3, le=20)] = 6.0
    width: Annotated[Ratio, about("Size across the closing line over the kind's usual one; the volume stays.")] = 1.0
    length: Annotated[Ratio, about("Size along the closing line over the kind's usual one; the volume stays.")] = 1.0
    height: Annotated[Ratio, about("Height over the kind's usual one; the volume stays.")] = 1.0
    ropes: Annotated[Literal[1, 2, 4], about("Number of ropes that the grab hangs on.")] = 4
    plate_work: Annotated[Share, about("Ribs and stiffeners on the plates: 0 is smooth.")] = 0.5
    teeth: Annotated[int, about("Number of teeth on the cutting edges.", ge=0, le=12)] = 0
    ladder: Annotated[bool, about("Whether a ladder is mounted on the head.")] = False
    guards: Annotated[bool, about("Whether guard rails stand on the head.")] = False
    markings: Annotated[bool, about("Whether markings are painted on the grab.")] = True


class OrangePeel(Shaped, frozen=True, tag="orange-peel"):
    """An orange-peel grab: tines round a vertical axis.

    ``shells`` tells how much of the bowl their plates close: all of it, for bulk; half of it; or next to nothing, as
    claws for scrap, which hold no bulk. ``width`` and ``length`` act on its diameter together. It needs two or four
    ropes, or ``drive = "hydraulic"``.
    """

    tines: Annotated[Literal[3, 4, 5, 6, 8], about("Number of tines.")] = 6
    shells: Annotated[Shells, about("How much of the bowl the tines' plates close.")] = "closed"
    drive: Annotated[Literal["ropes", "hydraulic"], about("What closes the jaws.")] = "ropes"

    def check(self) -> None:  # noqa: D102
        check_ropes(self.ropes, self.drive)


class Clamshell(Shaped, frozen=True, tag="clamshell"):
    """A clamshell grab of two shells, whose ``profile`` is that of their backs seen along the closing line.

    ``top = "closed"`` gives the shells roofs against spillage. With ropes, ``arms`` is how many hold the shells to the
    head; a single rope hangs on a hook block, and a latch inside the grab works the jaws.
    """

    top: Annotated[Literal["open", "closed"], about("Whether roofs close the shells from above.")] = "open"
    profile: Annotated[Profile, about("Shape of the shells' backs, seen along the closing line.")] = "round"
    arms: Annotated[Literal[2, 4], about("Number of arms between shells and head.")] = 4
    head: Annotated[Literal["frame", "block", "round"], about("Kind of head.")] = "frame"
    drive: Annotated[Literal["ropes", "hydraulic"], about("What closes the jaws.")] = "ropes"


class Scissors(Shaped, frozen=True, tag="scissors"):
    """A scissors grab: its shells hang on levers that cross at a pivot, and ropes draw the levers' upper ends together.

    It needs two or four ropes.
    """

    top: Annotated[Literal["open", "closed"], about("Whether roofs close the shells from above.")] = "open"
    profile: Annotated[Profile, about("Shape of the shells' backs, seen along the closing line.")] = "round"

    def check(self) -> None:  # noqa: D102
        check_ropes(self.ropes, "ropes")


def check_ropes(ropes: int, drive: str) -> None:
    """Refuse a single rope for jaws that a second one has to close."""
    if drive == "ropes" and ropes == 1:
        raise ValueError("ropes must be 2 or 4: a single rope cannot both hold and close the grab")


class Assembled(GrabAppearance, frozen=True, tag="assembled"):
    """A grab of no real kind, put together at random, for training a detector.

    Every ``shape`` gives another one. ``volume_m3`` scales its size; it is not what the grab holds.
    """

    shape: Annotated[Share, about("Selects the shape; every value gives another one.")] = 0.5
    volume_m3: Annotated[float, about("Scales the size; it is not what the grab holds.", ge=3, le=20)] = 6.0
    ropes: Annotated[Literal[1, 2, 4], about("Number of ropes that the grab hangs on.")] = 4


class Jaw(Strict, frozen=True):
    """A moving part of a user's own grab: a node of the file with all below it.

    To open, it turns about an axis through ``hinge_m`` by ``open_deg`` (right-handed), or it slides along the axis by
    ``stroke_m``. ``lips_m`` are ends of its cutting edge, which become keypoints.
    """

    node: Annotated[str, about("Node of the file, with all below it.", min_length=1, max_length=200)]
    hinge_m: Annotated[Point, about("Point on the axis.")] = (0.0, 0.0, 0.0)
    axis: Annotated[Point, about("Direction of the axis.")] = (0.0, 1.0, 0.0)
    open_deg: Annotated[float, about("Rotation from closed to open, right-handed.", ge=-180, le=180)] = 0.0
    stroke_m: Annotated[float, about("Travel along the axis from closed to open.")] = 0.0
    lips_m: Annotated[tuple[Point, ...], about("Ends of its cutting edge, as keypoints.", max_length=4)] = ()

    def check(self) -> None:  # noqa: D102
        if (self.open_deg == 0) == (self.stroke_m == 0):
            raise ValueError("a jaw needs either open_deg or stroke_m")
        if math.hypot(*self.axis) < 1e-6:
            raise ScenarioError("axis", "must be a direction, not zero")


class Mesh(OfFile, GrabAppearance, frozen=True, kw_only=True, tag="mesh"):
    """A user's own grab, closed and empty, from a file: GLB, glTF, OBJ, PLY or STL.

    With ``scale``, ``up`` and ``yaw_deg`` applied, all points are in metres, z up, from the file's origin. With
    ``finish = "paint"``, or where the file has no colours, the grab is painted as others are. Jaws open together, each
    in proportion; they need a file with named nodes.
    """

    reader: ClassVar[ModuleType] = models

    file: Annotated[File, about("GLB, glTF, OBJ, PLY or STL file; its path is absolute or from the scene's folder.")]
    sha256: Sha256 = ""
    scale: Annotated[float, about("Metres per unit of the file.", gt=0, le=1e6)] = 1.0
    up: Annotated[Up, about("Axis of the file that points up; auto is y in glTF and GLB, z in others.")] = "auto"
    yaw_deg: Annotated[float, about("Turn about the vertical.", ge=-360, le=360)] = 0.0
    centre_m: Annotated[Point | None, about("Grab centre A; by default on the ropes' axis, at half the height.")] = None
    ropes: Annotated[Literal[1, 2, 4], about("Number of ropes that the grab hangs on.")] = 4
    rope_ends_m: Annotated[tuple[Point, ...], about("Where the ropes end; by default at the top of the middle.")] = ()
    lips_m: Annotated[tuple[Point, ...], about("Ends of the cutting edges, as keypoints.", max_length=4)] = ()
    mass_kg: Annotated[Mass | None, about("Mass; by default estimated from the shape.")] = None
    drag_area_m2: Annotated[DragArea | None, about("Drag coefficient times area; by default from the shape.")] = None
    finish: Annotated[Literal["file", "paint"], about("Colours of the file, or paint as on other grabs.")] = "file"
    jaws: Annotated[tuple[Jaw, ...], about("Moving parts.", max_length=16)] = ()

    def check(self) -> None:
        """Refuse what does not fit together."""
        super().check()
        if self.rope_ends_m and len(self.rope_ends_m) != self.ropes:
            raise ScenarioError("rope_ends_m", f"{len(self.rope_ends_m)} points for {self.ropes} ropes")
        if sum(map(len, (self.lips_m, *(jaw.lips_m for jaw in self.jaws)))) > 4:
            raise ScenarioError("lips_m", "at most 4 keypoints in all, those of jaws included")
        if len({jaw.node for jaw in self.jaws}) < len(self.jaws):
            raise ScenarioError("jaws", "two jaws have the same node")
        if self.jaws and not any(jaw.open_deg for jaw in self.jaws):
            raise ScenarioError("jaws", "at least one jaw needs open_deg, which measures the opening")


Grab = FourRope | Clamshell | OrangePeel | Scissors | Assembled | Mesh
