"""The grab: its kind, shape and looks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from simgrab.errors import ScenarioError
from simgrab.io import models
from simgrab.model.scenario.base import Cargo, Meta, Share, Strict, Tagged

Point = tuple[float, float, float]
Ratio = Annotated[float, Meta(ge=0.75, le=1.35)]


class Looks(Tagged, frozen=True):
    """What all grabs have. ``wear`` and ``residue`` go from 0 (new, clean) to 1."""

    paint_rgb: tuple[Share, Share, Share] = (0.86, 0.52, 0.07)
    wear: Share = 0.4
    residue: Share = 0.3
    cargo: Cargo = "coal"


class FourRope(Looks, frozen=True, tag="four-rope"):
    """A clamshell of fixed shape on four ropes: 10.5 t, 24 t full, 2.9 × 2.4 × 3.4 m closed."""


class Shaped(Looks, frozen=True):
    """What all parametric grabs have.

    ``volume_m3`` is what the closed grab holds. ``width`` (across the closing line), ``length`` (along it) and
    ``height`` are relative to the usual proportions of its kind: they are scaled together, so that the volume stays.
    ``plate_work`` goes from 0 (smooth) to 1 (many ribs and stiffeners).
    """

    volume_m3: Annotated[float, Meta(ge=3, le=20)] = 6.0
    width: Ratio = 1.0
    length: Ratio = 1.0
    height: Ratio = 1.0
    ropes: Literal[1, 2, 4] = 4
    plate_work: Share = 0.5
    teeth: Annotated[int, Meta(ge=0, le=12)] = 0
    ladder: bool = False
    guards: bool = False
    markings: bool = True


class OrangePeel(Shaped, frozen=True, tag="orange-peel"):
    """An orange-peel grab: tines round a vertical axis.

    ``shells`` tells how much of the bowl their plates close: all of it, for bulk; half of it; or next to nothing, as
    claws for scrap, which hold no bulk. ``width`` and ``length`` act on its diameter together. It needs two or four
    ropes, or ``drive = "hydraulic"``.
    """

    tines: Literal[3, 4, 5, 6, 8] = 6
    shells: Literal["closed", "half", "open"] = "closed"
    drive: Literal["ropes", "hydraulic"] = "ropes"

    def check(self) -> None:  # noqa: D102
        check_ropes(self.ropes, self.drive)


class Clamshell(Shaped, frozen=True, tag="clamshell"):
    """A clamshell grab of two shells, whose ``profile`` is that of their backs seen along the closing line.

    ``top = "closed"`` gives the shells roofs against spillage. With ropes, ``arms`` is how many hold the shells to the
    head; a single rope hangs on a hook block, and a latch inside the grab works the jaws.
    """

    top: Literal["open", "closed"] = "open"
    profile: Literal["round", "angular"] = "round"
    arms: Literal[2, 4] = 4
    head: Literal["frame", "block", "round"] = "frame"
    drive: Literal["ropes", "hydraulic"] = "ropes"


class Scissors(Shaped, frozen=True, tag="scissors"):
    """A scissors grab: its shells hang on levers that cross at a pivot, and ropes draw the levers' upper ends together.

    It needs two or four ropes.
    """

    top: Literal["open", "closed"] = "open"
    profile: Literal["round", "angular"] = "round"

    def check(self) -> None:  # noqa: D102
        check_ropes(self.ropes, "ropes")


def check_ropes(ropes: int, drive: str) -> None:
    """Refuse a single rope for jaws that a second one has to close."""
    if drive == "ropes" and ropes == 1:
        raise ValueError("ropes must be 2 or 4: one cannot hold the grab and close it")


class Assembled(Looks, frozen=True, tag="assembled"):
    """A grab of no real kind, put together at random, for training a detector.

    Every ``shape`` gives another one. ``volume_m3`` scales its size; it is not what the grab holds.
    """

    shape: Share = 0.5
    volume_m3: Annotated[float, Meta(ge=3, le=20)] = 6.0
    ropes: Literal[1, 2, 4] = 4


class Jaw(Strict, frozen=True):
    """A moving part of a user's own grab: a node of the file with all below it.

    To open, it turns about an axis through ``hinge_m`` by ``open_deg`` (right-handed), or it slides along the axis by
    ``stroke_m``. ``lips_m`` are ends of its cutting edge, which become keypoints.
    """

    node: Annotated[str, Meta(min_length=1, max_length=200)]
    hinge_m: Point = (0.0, 0.0, 0.0)
    axis: Point = (0.0, 1.0, 0.0)
    open_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    stroke_m: float = 0.0
    lips_m: Annotated[tuple[Point, ...], Meta(max_length=4)] = ()

    def check(self) -> None:  # noqa: D102
        if (self.open_deg == 0) == (self.stroke_m == 0):
            raise ValueError("a jaw needs either open_deg or stroke_m")
        if math.hypot(*self.axis) < 1e-6:
            raise ScenarioError("axis", "must be a direction, not zero")


class Mesh(Looks, frozen=True, kw_only=True, tag="mesh"):
    """A user's own grab, closed and empty, from a file: GLB, glTF, OBJ, PLY or STL.

    A scene file names it by its path, absolute or from the scene file's folder. ``scale`` gives metres a unit, ``up``
    the file's axis that points up (``"auto"``: y in glTF, z in others), ``yaw_deg`` a turn about it. All points are
    then in metres, z up, from the file's origin. ``centre_m`` is the grab's centre A: by default on the ropes' axis at
    half the height.
    ``rope_ends_m`` are where the ropes end, by default at the top of the middle. ``mass_kg`` and ``drag_area_m2`` (drag
    coefficient times area) are estimated from the shape unless given. With ``finish = "paint"``, or where the file has
    no colours, the grab is painted as others are. Jaws open together, each in proportion; they need a file with named
    nodes.
    """

    file: Annotated[str, Meta(min_length=1, max_length=4096)]
    sha256: Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")] = ""
    scale: Annotated[float, Meta(gt=0, le=1e6)] = 1.0
    up: Literal["auto", "x", "y", "z", "-x", "-y", "-z"] = "auto"
    yaw_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    centre_m: Point | None = None
    ropes: Literal[1, 2, 4] = 4
    rope_ends_m: tuple[Point, ...] = ()
    lips_m: Annotated[tuple[Point, ...], Meta(max_length=4)] = ()
    mass_kg: Annotated[float, Meta(ge=50, le=200_000)] | None = None
    drag_area_m2: Annotated[float, Meta(ge=0, le=500)] | None = None
    finish: Literal["file", "paint"] = "file"
    jaws: Annotated[tuple[Jaw, ...], Meta(max_length=16)] = ()

    @classmethod
    def of(cls, path: str | Path, **keys: Any) -> Mesh:
        """Read a model; ``keys`` are the other fields.

        Raises
        ------
        ScenarioError
            If it cannot be read, or the keys do not fit.
        """
        model = models.read(path, lambda problem: ScenarioError("file", problem))
        return cls(file=model.name, sha256=model.sha256, **keys)

    def check(self) -> None:
        """Refuse what does not fit together."""
        # A scene of a stranger becomes such a table too: no file is opened here.
        if not self.sha256 or Path(self.file).name != self.file:
            raise ScenarioError("file", "a model is read by simgrab.load, from a scene file, or by Mesh.of")
        if self.rope_ends_m and len(self.rope_ends_m) != self.ropes:
            raise ScenarioError("rope_ends_m", f"{len(self.rope_ends_m)} points for {self.ropes} ropes")
        if sum(map(len, (self.lips_m, *(jaw.lips_m for jaw in self.jaws)))) > 4:
            raise ScenarioError("lips_m", "at most 4 keypoints in all, those of jaws included")
        if len({jaw.node for jaw in self.jaws}) < len(self.jaws):
            raise ScenarioError("jaws", "two of them have the same node")
        if self.jaws and not any(jaw.open_deg for jaw in self.jaws):
            raise ScenarioError("jaws", "at least one needs open_deg, by which the opening is measured")


Grab = FourRope | Clamshell | OrangePeel | Scissors | Assembled | Mesh
