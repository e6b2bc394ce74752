"""The grab: its kind, shape and looks."""

from __future__ import annotations

from typing import Annotated, Literal

from simgrab.scenario.base import Cargo, Meta, Share, Tagged

Ratio = Annotated[float, Meta(ge=0.75, le=1.35)]


class Looks(Tagged, frozen=True):
    """What all grabs have. ``wear`` and ``residue`` go from 0 (new, clean) to 1."""

    paint_rgb: tuple[Share, Share, Share] = (0.86, 0.52, 0.07)
    wear: Share = 0.4
    residue: Share = 0.3
    cargo: Cargo = "coal"


class FourRope(Looks, frozen=True, tag="four-rope"):
    """The four-rope clamshell of 10.5 t, 2.9 × 2.4 × 3.4 m closed, whose shape is fixed."""


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


Grab = FourRope | Clamshell | OrangePeel | Scissors
