"""Files of 3-D models: the bytes of one and of all that it refers to, read before anything parses them.

A model may name other files: buffers and textures of glTF, material libraries of OBJ and their textures. They are read
from the model's own folder and from nowhere else, and whoever parses the model is given these bytes and no others.
A scenario names a model by the SHA-256 of its content; where it lies on this machine is remembered here.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from simgrab.utilities.parse import Refuse, read_bytes, shown

#: By the endings of their names.
FORMATS = ("glb", "gltf", "obj", "ply", "stl")
MOST_BYTES = 64 * 2**20
"""Of a model and all that it refers to."""
MOST_FILES = 64
MOST_FACES = 500_000
"""Triangles; also half of the numbers that one list of a file may have."""
MOST_NUMBERS = 8_000_000

_TEXTURE_KEYS = re.compile(r"(map_\w+|bump|disp|decal|norm|refl)\s", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Model:
    """A model's file and what it refers to.

    Attributes
    ----------
    name : str
        Of the model's own file.
    files : dict of str to bytes
        The model's own and those that it refers to, each by the name that is used there.
    """

    name: str
    files: Mapping[str, bytes]

    @property
    def format(self) -> str:
        """One of `FORMATS`."""
        return self.name.rpartition(".")[2].lower()

    @cached_property
    def sha256(self) -> str:
        """Of the file; where it refers to others, of what ``sha256sum`` prints of all, sorted by name."""
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in self.files.items()}
        if len(digests) == 1:
            return digests[self.name]
        listed = "".join(f"{digests[name]}  {name}\n" for name in sorted(digests))
        return hashlib.sha256(listed.encode()).hexdigest()


def copied(sha256: str) -> str:
    """Folder, within a dataset, of the copy of a model."""
    return f"grabs/{sha256[:12]}"


_places: dict[str, Path] = {}


def remember(sha256: str, path: Path) -> None:
    """Note where a model lies."""
    _places[sha256] = path


def place_of(sha256: str) -> Path | None:
    """Where a model lies that was read in this process, or in the one that started it."""
    return _places.get(sha256)


def recall(sha256: str, name: str, refuse: Refuse) -> Model:
    """Read a model again that a scenario names; refuses one that is not where it was, or has changed."""
    place = place_of(sha256)
    if place is None:
        raise refuse(f"{name}: it is not known where this file lies; read the scene from its file")
    model = read(place, refuse)
    if model.sha256 != sha256:
        raise refuse(f"{place} has changed since the scene was read")
    return model


def read(path: str | Path, refuse: Refuse) -> Model:
    """Read a model with all that it refers to, and remember where it lies.

    Parameters
    ----------
    path : str or Path
    refuse : callable
        From a message to the error that is raised: for what cannot be read, is larger than `MOST_BYTES` together, has
        more than `MOST_FACES` triangles by its own statement, or refers to a file outside its folder.
    """
    path = Path(path)
    if path.suffix[1:].lower() not in FORMATS:
        raise refuse(f"{path.name}: must end in one of {', '.join(f'.{ending}' for ending in FORMATS)}")
    files = {path.name: read_bytes(path, refuse, most_bytes=MOST_BYTES)}
    waiting = [path.name]
    while waiting:
        name = waiting.pop(0)
        about = _about(name, refuse)
        for found in _references(name, files[name], about):
            if found in files:
                continue
            if len(files) >= MOST_FILES:
                raise refuse(f"{path.name}: refers to more than {MOST_FILES - 1} other files")
            left = MOST_BYTES - sum(map(len, files.values()))
            files[found] = read_bytes(inside(path.parent, found, about), about, most_bytes=left)
            waiting.append(found)
    model = Model(path.name, files)
    _check_counts(model, _about(path.name, refuse))
    remember(model.sha256, path.absolute())
    return model


def _about(name: str, refuse: Refuse) -> Refuse:
    return lambda problem: refuse(f"{name}: {problem}")


def inside(folder: Path, found: str, refuse: Refuse) -> Path:
    """Resolve the name of a file that may not leave a folder, by links neither."""
    target = folder / found
    try:
        leaves = not target.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a NUL byte, a loop of links
        leaves = True
    if leaves or os.path.isabs(found) or "\\" in found:  # noqa: PTH117
        raise refuse(f"refers to {shown(found)}, which is outside its folder")
    return target


def _references(name: str, data: bytes, refuse: Refuse) -> Iterator[str]:
    """Name what a file refers to."""
    kind = name.rpartition(".")[2].lower()
    if kind in ("glb", "gltf"):
        content = gltf(kind, data, refuse)
        for table in ("buffers", "images"):
            for entry in _tables(content, table, refuse):
                uri = entry.get("uri")
                if isinstance(uri, str) and not uri.startswith("data:"):
                    if re.match(r"[a-zA-Z][a-zA-Z0-9+.-]*:", uri):
                        raise refuse(f"refers to {shown(uri)}, which is not a file of its folder")
                    yield unquote(uri)
    elif kind == "obj":
        yield from (line[7:].strip() for line in _lines(data) if line.startswith("mtllib "))
    elif kind == "mtl":
        yield from (line.split()[-1] for line in map(str.strip, _lines(data)) if _TEXTURE_KEYS.match(line))
    elif kind == "ply":
        head = data[:100_000].partition(b"end_header")[0]
        words = (line.split() for line in _lines(head))
        yield from (line[2] for line in words if len(line) == 3 and line[:2] == ["comment", "TextureFile"])


def _lines(data: bytes) -> list[str]:
    return data.decode("utf-8", errors="replace").splitlines()


def gltf(kind: str, data: bytes, refuse: Refuse) -> dict[str, Any]:
    """Read the JSON of a glTF file, or of a GLB's first chunk."""
    if kind == "glb":
        if len(data) < 20 or data[:4] != b"glTF":
            raise refuse("is not a GLB file")
        version, length, chunk, tag = struct.unpack("<4x4I", data[:20])
        if version != 2 or tag != 0x4E4F534A or length > len(data) or 20 + chunk > len(data):
            raise refuse("is truncated, or not a GLB file of version 2")
        data = data[20 : 20 + chunk]
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise refuse("its glTF is not valid JSON") from None
    if not isinstance(content, dict):
        raise refuse("its glTF is not a JSON object")
    needed = content.get("extensionsRequired")
    if needed:
        raise refuse(f"needs the glTF extension {shown(needed)}: export it without compression")
    return content


def pictures(model: Model, refuse: Refuse) -> Iterator[bytes]:
    """Give all textures of a model, as they lie in its files."""
    about = _about(model.name, refuse)
    for name, data in model.files.items():
        if name.rpartition(".")[2].lower() in ("png", "jpg", "jpeg", "bmp", "tif", "tiff", "tga", "webp", "gif"):
            yield data
    if model.format not in ("glb", "gltf"):
        return
    data = model.files[model.name]
    content = gltf(model.format, data, about)
    views, buffers = _tables(content, "bufferViews", about), _tables(content, "buffers", about)
    for entry in _tables(content, "images", about):
        uri, view = entry.get("uri"), entry.get("bufferView")
        try:
            if isinstance(uri, str) and uri.startswith("data:"):
                yield base64.b64decode(uri.partition(",")[2])
            elif view is not None:
                named = buffers[views[view]["buffer"]].get("uri")
                if named is None:
                    chunk = 20 + int.from_bytes(data[12:16], "little")
                    whole = data[chunk + 8 :]
                elif named.startswith("data:"):
                    whole = base64.b64decode(named.partition(",")[2])
                else:
                    whole = model.files[unquote(named)]
                start = views[view].get("byteOffset", 0)
                yield whole[start : start + views[view]["byteLength"]]
        except (LookupError, TypeError, ValueError, AttributeError):
            raise about("a texture lies nowhere in its buffers") from None


def _tables(content: Mapping[str, Any], name: str, refuse: Refuse) -> list[dict[str, Any]]:
    entries = content.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise refuse(f"its {name} are not a list of JSON objects")
    return entries


def _check_counts(model: Model, refuse: Refuse) -> None:
    """Refuse a model that states more than there may be, before memory is taken for it."""
    data = model.files[model.name]
    faces = numbers = 0
    match model.format:
        case "glb" | "gltf":
            content = gltf(model.format, data, refuse)
            for entry in _tables(content, "accessors", refuse):
                numbers = max(numbers, _count(entry.get("count", 0), refuse))
            if len(_tables(content, "nodes", refuse)) > MOST_NUMBERS // 1000:
                raise refuse(f"has more than {MOST_NUMBERS // 1000} nodes")
        case "stl":
            binary = len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
            faces = (len(data) - 84) // 50 if binary else data.count(b"facet normal")
            if not binary and not faces:
                raise refuse("is truncated, or not an STL file")
        case "obj":
            lines = data.splitlines()
            numbers = sum(line.count(b" ") for line in lines if line.startswith(b"f"))
            faces = sum(max(line.count(b" ") - 2, 1) for line in lines if line.startswith(b"f"))
        case "ply":
            for line in _lines(data[:100_000].partition(b"end_header")[0]):
                words = line.split()
                if words[:1] == ["element"] and len(words) == 3:
                    count = _count(int(words[2]) if re.fullmatch("[0-9]{1,15}", words[2]) else words[2], refuse)
                    faces, numbers = (count, numbers) if words[1] == "face" else (faces, max(numbers, count))
    if faces > MOST_FACES:
        raise refuse(f"has {faces} triangles or more; the limit is {MOST_FACES}: simplify it")
    if numbers > MOST_NUMBERS:
        raise refuse(f"states a list of {numbers} entries; the limit is {MOST_NUMBERS}: simplify it")


def _count(value: Any, refuse: Refuse) -> int:
    if not isinstance(value, int) or value < 0:
        raise refuse(f"states a number of elements of {shown(value)}")
    return value
