"""What there is to see: the grab's looks, the jib, the place below, sun and sky."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from simgrab.errors import ScenarioError
from simgrab.io import photographs
from simgrab.model.scenario.base import Cargo, Meta, Share, Strict, Tagged


class Jib(Strict, frozen=True):
    """The jib head: how high the rope exit O hangs above the quay, its ropes, and whether its steel is there.

    The spreads are those of four ropes at their exits, outboard and sideways; two ropes hang side by side, 0.24 m less
    apart than the second, and a single rope hangs from O. With ``head = "none"`` the ropes come out of nothing, as on a
    crane whose camera sees none of its head.
    """

    head_height_m: Annotated[float, Meta(ge=22, le=35)] = 28.0
    head: Literal["portal", "none"] = "portal"
    rope_spread_x_m: Annotated[float, Meta(ge=0.2, le=0.8)] = 0.45
    rope_spread_y_m: Annotated[float, Meta(ge=0.5, le=1.2)] = 1.1
    rope_diameter_mm: Annotated[float, Meta(ge=16, le=50)] = 32.0


class Plain(Tagged, frozen=True, tag="plain"):
    """An empty concrete yard: quick to build, nothing to distract."""


class RandomPlace(Tagged, frozen=True, tag="random"):
    """Level ground with random textures and random solids on it, for domain randomisation."""


class Quay(Tagged, frozen=True, tag="quay"):
    """Quay apron: rails, markings, a bulk pile, and a hopper or truck to dump into."""

    cargo: Cargo = "coal"
    receiver: Literal["hopper", "truck", "none"] = "hopper"
    pile_height_m: Annotated[float, Meta(ge=0, le=5)] = 2.5
    wear: Share = 0.5


class Hold(Tagged, frozen=True, tag="hold"):
    """A bulk carrier's hold: coaming, frames, tank top, and a heap that fills it by ``fill``."""

    cargo: Cargo = "coal"
    fill: Share = 0.4
    depth_m: Annotated[float, Meta(ge=12, le=18)] = 15.0
    wear: Share = 0.5


class Water(Tagged, frozen=True, tag="water"):
    """Water beside the hull, with the quay wall opposite."""

    freeboard_m: Annotated[float, Meta(ge=2, le=8)] = 4.0
    quay_height_m: Annotated[float, Meta(ge=1.5, le=6)] = 3.0
    chop: Share = 0.3


class Photo(Tagged, frozen=True, kw_only=True, tag="photo"):
    """What the camera sees below the jib, from a photograph, a folder of photographs, or a video.

    A scene file names the file or folder by its path, absolute or from the scene file's folder. A photograph fills
    the picture as it is: it is scaled and cut to the picture's size, and not warped. It hides ground as level as
    ``plain``, on which the grab casts its shadow. The scene's light falls on grab, ropes and jib head alone. Of a
    folder, each independent frame, or each clip, shows a random photograph. A video begins with each clip, goes on
    frame by frame, and repeats.
    """

    file: Annotated[str, Meta(min_length=1, max_length=4096)]
    sha256: Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")] = ""

    @classmethod
    def of(cls, path: str | Path) -> Photo:
        """Read photographs or a video.

        Raises
        ------
        ScenarioError
            If they cannot be read.
        """
        model = photographs.read(path, lambda problem: ScenarioError("file", problem))
        return cls(file=model.name, sha256=model.sha256)

    def check(self) -> None:
        """Refuse a file that was not read: a scene of a stranger becomes such a table too."""
        if not self.sha256 or Path(self.file).name != self.file:
            raise ScenarioError("file", "it is read by simgrab.load, from a scene file, or by Photo.of")


Place = Quay | Hold | Water | Plain | RandomPlace | Photo
Kind = Literal["four-rope", "clamshell", "orange-peel", "scissors", "assembled"]


class Clutter(Strict, frozen=True):
    """What stands about that could be mistaken: grabs of other cranes, parked, as many as find level ground.

    Each is of one of ``kinds``, and of random size and proportions where its kind has any.
    """

    other_grabs: Annotated[int, Meta(ge=0, le=4)] = 0
    kinds: Annotated[tuple[Kind, ...], Meta(min_length=1)] = ("four-rope",)


class Light(Strict, frozen=True):
    """Sun, sky, and at night the jib's floodlights, each relative to a clear day at the same exposure.

    ``floodlights`` is their light on a surface 28 m straight below. Azimuth as all azimuths: counter-clockwise from x,
    seen from above.
    """

    sun_elevation_deg: Annotated[float, Meta(ge=10, le=90)] = 48.0
    sun_azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 130.0
    sun: Annotated[float, Meta(ge=0, le=2)] = 1.0
    sky: Annotated[float, Meta(ge=0, le=2)] = 0.85
    floodlights: Annotated[float, Meta(ge=0, le=2)] = 0.0

    def check(self) -> None:  # noqa: D102
        if self.sun == 0 and self.sky == 0 and self.floodlights == 0:
            raise ValueError("sun, sky and floodlights must not all be 0: the image would be black")
        if self.floodlights > 0 and self.sun > 0:
            raise ValueError(f"floodlights are for the night: set sun = 0 (it is {self.sun:g})")
