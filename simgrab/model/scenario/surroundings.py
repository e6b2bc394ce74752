"""What there is to see: the grab's appearance, the jib, the place below, sun and sky."""

from __future__ import annotations

from types import ModuleType
from typing import Annotated, ClassVar, Literal

from simgrab.io import photographs
from simgrab.model.scenario.base import Azimuth, Cargo, File, OfFile, Sha256, Share, Strict, Tagged, about
from simgrab.model.scenario.grab import Mesh


class Jib(Strict, frozen=True):
    """The jib head: how high the rope exit O hangs above the quay, its ropes, and whether its steel is there.

    The spreads are those of four ropes at their exits, outboard and sideways; two ropes hang side by side, 0.24 m less
    apart than the second, and a single rope hangs from O. With ``head = "none"`` the ropes come out of nothing, as on a
    crane whose camera sees none of its head.
    """

    head_height_m: Annotated[float, about("Height of the rope exit O above the quay.", ge=22, le=60)] = 28.0
    head: Annotated[Literal["portal", "none"], about("Whether the steel of the jib head is there.")] = "portal"
    rope_spread_x_m: Annotated[float, about("Distance between rope exits, outboard.", ge=0.2, le=0.8)] = 0.45
    rope_spread_y_m: Annotated[float, about("Distance between rope exits, sideways.", ge=0.5, le=1.2)] = 1.1
    rope_diameter_mm: Annotated[float, about("Diameter of the ropes.", ge=16, le=50)] = 32.0


class Plain(Tagged, frozen=True, tag="plain"):
    """An empty concrete yard: quick to build, nothing to distract."""


class RandomPlace(Tagged, frozen=True, tag="random"):
    """Level ground with random textures and random solids on it, for domain randomisation."""


class Quay(Tagged, frozen=True, tag="quay"):
    """Quay apron: rails, markings, a bulk pile, and a hopper or truck to dump into."""

    cargo: Annotated[Cargo, about("Bulk cargo in the place.")] = "coal"
    receiver: Annotated[Literal["hopper", "truck", "none"], about("What the cargo is dumped into.")] = "hopper"
    pile_height_m: Annotated[float, about("Height of the bulk pile; 0 is none.", ge=0, le=5)] = 2.5
    wear: Annotated[Share, about("Age of the place: 0 is new.")] = 0.5


class Hold(Tagged, frozen=True, tag="hold"):
    """A bulk carrier's hold: coaming, frames, tank top, and a heap that fills it by ``fill``."""

    cargo: Annotated[Cargo, about("Bulk cargo in the place.")] = "coal"
    fill: Annotated[Share, about("How full the hold is.")] = 0.4
    depth_m: Annotated[float, about("Depth of the hold.", ge=12, le=18)] = 15.0
    wear: Annotated[Share, about("Age of the place: 0 is new.")] = 0.5


class Water(Tagged, frozen=True, tag="water"):
    """Water beside the hull, with the quay wall opposite."""

    freeboard_m: Annotated[float, about("Height of the ship's deck above the water.", ge=2, le=8)] = 4.0
    quay_height_m: Annotated[float, about("Height of the quay above the water.", ge=1.5, le=6)] = 3.0
    chop: Annotated[Share, about("Waves: 0 is calm.")] = 0.3


class Photo(OfFile, Tagged, frozen=True, kw_only=True, tag="photo"):
    """What the camera sees below the jib, from a photograph, a folder of photographs, or a video.

    A photograph fills the picture as it is: it is scaled and cut to the picture's size, and not warped. It hides ground
    as level as ``plain``, on which the grab casts its shadow. The scene's light falls on grab, ropes and jib head
    alone. Of a folder, each independent frame, or each clip, shows a random photograph. A video begins with each clip,
    goes on frame by frame, and repeats.
    """

    reader: ClassVar[ModuleType] = photographs

    file: Annotated[File, about("Photograph, video or folder of photographs; absolute or from the scene's folder.")]
    sha256: Sha256 = ""


Place = Quay | Hold | Water | Plain | RandomPlace | Photo
Kind = Literal["four-rope", "clamshell", "orange-peel", "scissors", "assembled"]


class Clutter(Strict, frozen=True):
    """What stands about that could be mistaken: grabs of other cranes, parked, as many as find level ground.

    Each is of one of ``kinds``, and of random size and proportions where its kind has any; or it is a model of a file.
    """

    other_grabs: Annotated[int, about("Number of parked grabs, as many as find level ground.", ge=0, le=4)] = 0
    kinds: Annotated[
        tuple[Kind | Mesh, ...], about("Kinds that are drawn, or models as in `[grab]`.", min_length=1)
    ] = ("four-rope",)


class Light(Strict, frozen=True):
    """Sun, sky, and at night the jib's floodlights, each relative to a clear day at the same exposure."""

    sun_elevation_deg: Annotated[float, about("Elevation of the sun.", ge=10, le=90)] = 48.0
    sun_azimuth_deg: Annotated[Azimuth, about("Azimuth of the sun, from outboard.")] = 130.0
    sun: Annotated[float, about("Light of the sun, relative to a clear day.", ge=0, le=2)] = 1.0
    sky: Annotated[float, about("Light of the sky, relative to a clear day.", ge=0, le=2)] = 0.85
    floodlights: Annotated[float, about("Light of the jib's floodlights 28 m below; needs sun = 0.", ge=0, le=2)] = 0.0

    def check(self) -> None:  # noqa: D102
        if self.sun == 0 and self.sky == 0 and self.floodlights == 0:
            raise ValueError("sun, sky and floodlights must not all be 0: the image would be black")
        if self.floodlights > 0 and self.sun > 0:
            raise ValueError(f"floodlights are for the night: set sun = 0 (it is {self.sun:g})")
