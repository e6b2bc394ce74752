"""The font of the display's rope lengths: the bundled one, a user's own, or one that is generated."""

from __future__ import annotations

from types import ModuleType
from typing import Annotated, ClassVar, Literal

from simgrab.io import fonts
from simgrab.model.scenario.base import File, OfFile, Rgb, Sha256, Share, Strict, Tagged, about

Style = Literal["any", "strokes", "segments", "dots"]


class Ink(Strict, frozen=True):
    """Colours of the digits, sRGB. The plate lies behind each number, and ends with its digits' cells."""

    fill_rgb: Annotated[Rgb, about("Colour of the digits: red, green and blue from 0 to 1, sRGB.")] = (1.0, 1.0, 1.0)
    outline_rgb: Annotated[Rgb, about("Colour of the outline, sRGB.")] = (0.0, 0.0, 0.0)
    outline: Annotated[float, about("Width of the outline over the font's size; 0 is none.", ge=0, le=0.15)] = 0.05
    plate_rgb: Annotated[Rgb, about("Colour of the plate behind each number, sRGB.")] = (0.0, 0.0, 0.0)
    plate: Annotated[Share, about("Opacity of the plate; 0 is none.")] = 0.0


class BundledFont(Tagged, frozen=True, tag="bundled"):
    """The bundled font, WenQuanYi Micro Hei."""

    ink: Annotated[Ink, about("Colours, outline and plate.")] = Ink()


class FontFile(OfFile, Tagged, frozen=True, kw_only=True, tag="file"):
    """A user's own font: TTF or OTF, with all ten digits and the full stop."""

    reader: ClassVar[ModuleType] = fonts

    file: Annotated[File, about("TTF or OTF file; its path is absolute or from the scene's folder.")]
    sha256: Sha256 = ""
    ink: Annotated[Ink, about("Colours, outline and plate.")] = Ink()


class GeneratedFont(Tagged, frozen=True, tag="generated"):
    """A font of no real kind, for training a reader: of pen strokes, seven segments, or dots.

    Every ``shape`` gives another one, of which ``style`` and ``ink`` are drawn too unless given.
    """

    style: Annotated[Style, about("What digits are made of: pen strokes, seven segments, or dots.")] = "any"
    shape: Annotated[Share | None, about("Chooses the font; absent: a random one for each frame, or clip.")] = None
    ink: Annotated[Ink | None, about("Colours, outline and plate; drawn with the font unless given.")] = None


Font = BundledFont | FontFile | GeneratedFont
