"""What is mounted for a method to look at: a plate with marks or a bright target on the grab, balls on the ropes."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.scenario.base import Meta, Rgb, Strict, Tagged, about

Offset = Annotated[float, Meta(ge=-3, le=3)]
Place = Annotated[tuple[Offset, Offset, Offset], about("Its middle from that of the rope ends, grab frame.")]
Distances = Annotated[tuple[Annotated[float, Meta(ge=0.5, le=40)], ...], Meta(min_length=1, max_length=8)]
Colour = Annotated[Rgb, about("Colour: red, green and blue from 0 to 1.")]
Size = Annotated[float, Meta(ge=0.1, le=3)]


class Mounted(Tagged, frozen=True):
    """A square plate that faces up, level in the grab's frame, on an arm from the middle T of the rope ends.

    By default it is where no rope hides it from the usual camera.
    """

    size_m: Annotated[Size, about("Edge of the plate, or of the tag's black square.")] = 0.8
    position_m: Place = (1.0, -0.45, 0.0)


class Circles(Mounted, frozen=True, tag="circles"):
    """Four black circles on white, as Wu et al. (2020) have them.

    Their centres form a square of half the plate's edge, and their diameter is 0.3 of it.
    """


class AprilTag(Mounted, frozen=True, tag="apriltag"):
    """A tag of AprilTag's family 36h11, from OpenCV's dictionary.

    The plate is a quarter larger. The tag's top points along the grab's x.
    """

    tag: Annotated[int, about("Number of the tag in its family.", ge=0, le=586)] = 0


class Target(Strict, frozen=True):
    """A bright disc that faces up, on an arm from T as a plate is."""

    diameter_m: Annotated[Size, about("Diameter of the disc.")] = 0.5
    position_m: Place = (-1.0, -0.45, 0.0)
    rgb: Colour = (1.0, 0.15, 0.05)


class Balls(Strict, frozen=True):
    """Balls in the middle between the ropes, on the line from O to T, at distances from O."""

    distances_m: Annotated[Distances, about("Distance of each ball from O.")] = (2.0, 4.0)
    diameter_m: Annotated[float, about("Diameter of a ball.", ge=0.05, le=1)] = 0.3
    rgb: Colour = (0.1, 0.8, 0.15)


class Markers(Strict, frozen=True):
    """What is mounted for a method to look at; nothing unless set. Plate and target count as grab, balls as ropes."""

    plate: Annotated[Circles | AprilTag | None, about("Plate with marks on the grab.")] = None
    target: Annotated[Target | None, about("Bright disc on the grab.")] = None
    balls: Annotated[Balls | None, about("Balls between the ropes.")] = None
