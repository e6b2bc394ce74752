"""The font of the display's rope lengths: the bundled one, a user's own, or one that is generated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from simgrab.errors import ScenarioError
from simgrab.io import fonts
from simgrab.model.scenario.base import Meta, Share, Strict, Tagged

Rgb = tuple[Share, Share, Share]


class Ink(Strict, frozen=True):
    """Colours of the digits, sRGB. ``outline`` is relative to the font's size; ``plate`` is the opacity of the plate.

    The plate lies behind each number, and ends with its digits' cells.
    """

    fill_rgb: Rgb = (1.0, 1.0, 1.0)
    outline_rgb: Rgb = (0.0, 0.0, 0.0)
    outline: Annotated[float, Meta(ge=0, le=0.15)] = 0.05
    plate_rgb: Rgb = (0.0, 0.0, 0.0)
    plate: Share = 0.0


class BundledFont(Tagged, frozen=True, tag="bundled"):
    """The bundled font, WenQuanYi Micro Hei."""

    ink: Ink = Ink()


class FontFile(Tagged, frozen=True, kw_only=True, tag="file"):
    """A user's own font: TTF or OTF, with all ten digits and the full stop.

    A scene file names it by its path, absolute or from the scene file's folder.
    """

    file: Annotated[str, Meta(min_length=1, max_length=4096)]
    sha256: Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")] = ""
    ink: Ink = Ink()

    @classmethod
    def of(cls, path: str | Path, **keys: Any) -> FontFile:
        """Read a font; ``keys`` are the other fields.

        Raises
        ------
        ScenarioError
            If it cannot be read, or has not all characters.
        """
        model = fonts.read(path, lambda problem: ScenarioError("file", problem))
        return cls(file=model.name, sha256=model.sha256, **keys)

    def check(self) -> None:
        """Refuse a file that was not read: a scene of a stranger becomes such a table too."""
        if not self.sha256 or Path(self.file).name != self.file:
            raise ScenarioError("file", "a font is read by simgrab.load, from a scene file, or by FontFile.of")


class GeneratedFont(Tagged, frozen=True, tag="generated"):
    """A font of no real kind, for training a reader: of pen strokes, seven segments, or dots.

    Every ``shape`` gives another one. Without it each independent frame, or each clip, shows a random one. ``style``
    and ``ink`` are drawn with the shape unless given.
    """

    style: Literal["any", "strokes", "segments", "dots"] = "any"
    shape: Share | None = None
    ink: Ink | None = None


Font = BundledFont | FontFile | GeneratedFont
