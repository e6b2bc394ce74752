"""The camera TOML: the camera as the instrument knows it. It never holds the tilt, which the instrument estimates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tomli_w

from simgrab.errors import CalibrationError, LayoutError
from simgrab.io.parse import parse_toml, read_toml
from simgrab.io.strict import Checked, convert
from simgrab.model import layouts
from simgrab.model.geometry import Distortion, Intrinsics
from simgrab.model.layouts import Layout

Meta = msgspec.Meta
Side = Annotated[int, Meta(ge=1, le=65_536)]
Pixel = Annotated[float, Meta(ge=-1e6, le=1e6)]
Coefficient = Annotated[float, Meta(ge=-1e9, le=1e9)]  # of a long lens, whose rays have small slopes, thousands
Metres = Annotated[float, Meta(ge=-1000, le=1000)]


class Calibration(Checked, frozen=True):
    """Intrinsics, distortion and the nominal offset of the camera from the rope exit.

    Attributes
    ----------
    width_px, height_px : int
    focal_length_px : float
        h = fx = fy.
    cx_px, cy_px : float
        Principal point; (0, 0) is the outer corner of the top-left pixel.
    k1, k2, p1, p2, k3 : float
        Brown–Conrady, OpenCV's order and signs.
    offset_m : tuple of 3 floats
        Nominal camera centre minus rope exit O, jib frame (x outboard, z up).
    offset_sd_m : float
        Standard deviation of each component of the offset.
    roll_deg : float
        Nominal turn of the camera about its optical axis, which orients the offset in the picture: positive if outboard
        is left of the picture's top.
    mount : str
        How the camera hangs: ``"fixed"`` if it does not lean as the crane moves, ``"levelled"``, or ``"rigid"`` if it
        pitches with the jib; empty if that is not known.
    display_constant_m : float
        |OA| minus the hoist rope's length on the display.
    digit_layout : Layout or None
        Layout of the display's digits; None if there is no display. It is the layout itself and not its name, so that
        the file is complete on any machine.
    assumed : tuple of str
        Names of the values above that are guesses. `load` adds offset, roll, lens distortion (``k1``) and the display's
        constant where the file leaves them out.
    """

    error = CalibrationError

    width_px: Side
    height_px: Side
    focal_length_px: Annotated[float, Meta(gt=0, le=1e6)]
    cx_px: Pixel
    cy_px: Pixel
    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0
    offset_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    offset_sd_m: Annotated[float, Meta(ge=0, le=1000)] = 0.5
    roll_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    mount: Literal["", "fixed", "levelled", "rigid"] = ""
    display_constant_m: Metres = 0.0
    digit_layout: Layout | None = None
    assumed: tuple[str, ...] = ()

    def check(self) -> None:  # noqa: D102
        for name in self.assumed:
            if name not in self.__struct_fields__[:-1]:
                raise ValueError(f"assumed: there is no {name!r}; name keys of this file, such as focal_length_px")

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole and its lens."""
        return Intrinsics(
            self.width_px,
            self.height_px,
            self.focal_length_px,
            self.cx_px,
            self.cy_px,
            Distortion(self.k1, self.k2, self.p1, self.p2, self.k3),
        )

    def scaled(self, width_px: int, height_px: int) -> Calibration:
        """Return the camera of pictures that show the same at another size, px.

        Raises
        ------
        CalibrationError
            If their shape is another one.
        LayoutError
            If the display's characters would be too small to read.
        """
        scale = scale_between((self.width_px, self.height_px), (width_px, height_px))
        if scale is None:
            raise CalibrationError(
                f"pictures of {width_px}x{height_px} px have another shape than {self.width_px}x{self.height_px} px"
            )
        layout = self.digit_layout
        return msgspec.structs.replace(
            self, width_px=width_px, height_px=height_px, focal_length_px=self.focal_length_px * scale,
            cx_px=self.cx_px * scale, cy_px=self.cy_px * scale,
            digit_layout=None if layout is None else layout.scaled(width_px, height_px),
        )  # fmt: skip

    def to_toml(self) -> str:
        """Return the camera TOML."""
        data = msgspec.to_builtins(self)
        return tomli_w.dumps({key: value for key, value in data.items() if value not in (None, [], (), "")})

    def save(self, path: str | Path) -> None:
        """Write a camera TOML."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")


def scale_between(size: tuple[int, int], other: tuple[int, int]) -> float | None:
    """By how much pictures of another size, px, are larger that show the same; None if their shape is another one."""
    scale = other[0] / size[0]
    return scale if abs(size[1] * scale - other[1]) <= (scale != 1) else None  # heights of copies are rounded


def load(path: str | Path) -> Calibration:
    """Read a camera TOML; raises `CalibrationError` with one line that names file and key.

    ``digit_layout`` may be a bundled layout's name there.
    """
    return _of(read_toml(path, CalibrationError, "camera file"), path)


def parse(text: str, where: str) -> Calibration:
    """Parse the text of a camera TOML as `load` does; ``where`` begins the error line."""
    return _of(parse_toml(text, CalibrationError, f"{where}: it is not valid TOML"), where)


def _of(data: dict[str, Any], where: str | Path) -> Calibration:
    if isinstance(data.get("digit_layout"), str):
        try:
            data["digit_layout"] = layouts.load(data["digit_layout"])
        except LayoutError as problem:
            raise CalibrationError(f"{where}: digit_layout: {problem}") from None
    found = convert(data, Calibration, CalibrationError, where)
    unstated = [key for key in ("k1", "offset_m", "roll_deg", "display_constant_m") if key not in data]
    if found.digit_layout is None and "display_constant_m" in unstated:
        unstated.remove("display_constant_m")
    return msgspec.structs.replace(found, assumed=tuple(dict.fromkeys((*found.assumed, *unstated))))
