"""Materials of a user's own grab, from its file."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from simgrab.errors import SimgrabError, first_line
from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.formats.contents import FileMaterial, Shape
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Material, Texture

TEXTURES = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")
MOST_TEXTURE_PX = 4096
MOST_PIXELS = 4 * MOST_TEXTURE_PX**2  # of all textures
MOST_COLOURS = 24  # of faces; more are brought together

MaterialFaces = tuple[NDArray[np.bool_], Material, Array | None]


class ShapeMaterials:
    """Materials of a model's shapes; each is made once.

    Parameters
    ----------
    painted : bool
        Whether the file's colours are left out.
    refuse : callable
        Makes the error to raise from a message, for textures that cannot be read or are too large.
    """

    def __init__(self, refuse: Callable[[str], SimgrabError], *, painted: bool) -> None:
        self._refuse, self._painted = refuse, painted
        self._made: dict[object, Material] = {}
        self._textures: dict[bytes, Texture] = {}

    def of(self, shape: Shape) -> Iterator[MaterialFaces]:
        """Return the faces of each material, and texture coordinates of the vertices."""
        every, surface = np.ones(len(shape.faces), bool), shape.surface or FileMaterial()
        if self._painted or (shape.surface is None and shape.colours is None):
            yield every, BARE.body, None
            return
        uv = shape.uv if shape.uv is not None and np.isfinite(shape.uv).all() else None
        texture = surface.texture if uv is not None else None
        if shape.colours is None:
            yield every, self._material(surface.rgb, texture, surface), uv
            return
        colours = np.rint(np.nan_to_num(shape.colours) * 255).astype(np.uint8)
        unique, index = np.unique(colours, axis=0, return_inverse=True)
        if len(unique) > MOST_COLOURS:
            fewer = Image.fromarray(colours[None]).quantize(MOST_COLOURS, dither=Image.Dither.NONE)
            unique, index = np.unique(np.asarray(fewer.convert("RGB"))[0], axis=0, return_inverse=True)
        for i, (red, green, blue) in enumerate(unique / 255.0):
            yield index.ravel() == i, self._material((float(red), float(green), float(blue)), texture, surface), uv

    def _material(self, rgb: tuple[float, float, float], picture: bytes | None, surface: FileMaterial) -> Material:
        key = rgb, picture, surface.specular, surface.shininess
        if key not in self._made:
            texture = None if picture is None else self._texture(picture)
            self._made[key] = Material(f"own_{len(self._made)}", (*rgb, 1.0), texture, specular=surface.specular,
                                       shininess=surface.shininess)  # fmt: skip
        return self._made[key]

    def _texture(self, picture: bytes) -> Texture:
        """Decode a picture; one that is too large is refused by its header, before decoding."""
        if picture in self._textures:
            return self._textures[picture]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Pillow warns of bombs
                with Image.open(io.BytesIO(picture), formats=TEXTURES) as image:
                    self._check_size(*image.size)
                    deep = image.mode.startswith("I;16")  # which Pillow would clip
                    plain = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)) if deep else image
                    decoded = np.ascontiguousarray(np.asarray(plain.convert("RGB"), np.uint8))
        except SimgrabError:
            raise
        except UnidentifiedImageError:
            raise self._refuse(f"a texture cannot be read: it is none of {', '.join(TEXTURES)}") from None
        except Exception as problem:  # Pillow's decoders raise whatever they run into
            raise self._refuse(f"a texture cannot be read ({first_line(problem)})") from None
        return self._textures.setdefault(picture, decoded)

    def _check_size(self, width: int, height: int) -> None:
        if max(width, height) > MOST_TEXTURE_PX:
            raise self._refuse(f"a texture of {width} × {height} px; at most {MOST_TEXTURE_PX} px a side")
        before = sum(texture.shape[0] * texture.shape[1] for texture in self._textures.values())
        if before + width * height > MOST_PIXELS:
            raise self._refuse(f"its textures have more than {MOST_PIXELS} pixels together")
