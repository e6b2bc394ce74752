"""What is mounted for a method to look at: a plate with marks or a bright target on the grab, balls on the ropes."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.scenario.base import Meta, Share, Strict, Tagged

Place = tuple[
    Annotated[float, Meta(ge=-3, le=3)], Annotated[float, Meta(ge=-3, le=3)], Annotated[float, Meta(ge=-3, le=3)]
]
Size = Annotated[float, Meta(ge=0.1, le=3)]
Colour = tuple[Share, Share, Share]


class Mounted(Tagged, frozen=True):
    """A square plate that faces up, level in the grab's frame, on an arm from the middle T of the rope ends.

    ``position_m`` is its middle from T, in the grab's frame; by default where no rope hides it from the usual camera.
    """

    size_m: Size = 0.8
    position_m: Place = (1.0, -0.45, 0.0)


class Circles(Mounted, frozen=True, tag="circles"):
    """Four black circles on white, as Wu et al. (2020) have them; ``size_m`` is the plate's edge.

    Their centres form a square of half the plate's edge, and their diameter is 0.3 of it.
    """


class AprilTag(Mounted, frozen=True, tag="apriltag"):
    """A tag of AprilTag's family 36h11, from OpenCV's dictionary; ``size_m`` is the edge of its black square.

    The plate is a quarter larger. The tag's top points along the grab's x.
    """

    tag: Annotated[int, Meta(ge=0, le=586)] = 0


class Target(Strict, frozen=True):
    """A bright disc that faces up, on an arm from T as a plate is."""

    diameter_m: Size = 0.5
    position_m: Place = (-1.0, -0.45, 0.0)
    rgb: Colour = (1.0, 0.15, 0.05)


class Balls(Strict, frozen=True):
    """Balls in the middle between the ropes, on the line from O to T, at distances from O."""

    distances_m: Annotated[tuple[Annotated[float, Meta(ge=0.5, le=40)], ...], Meta(min_length=1, max_length=8)] = (
        2.0, 4.0,
    )  # fmt: skip
    diameter_m: Annotated[float, Meta(ge=0.05, le=1)] = 0.3
    rgb: Colour = (0.1, 0.8, 0.15)


class Markers(Strict, frozen=True):
    """What is mounted for a method to look at; nothing unless set. Plate and target count as grab, balls as ropes."""

    plate: Circles | AprilTag | None = None
    target: Target | None = None
    balls: Balls | None = None
