"""Files of 3-D models: the bytes of one and of all that it refers to, read before anything parses them.

A model may name other files: buffers and textures of glTF, material libraries of OBJ and their textures. They are read
from the model's own folder and from nowhere else, and the parser is given these bytes and no others.
A scenario names a model by its file's name and the SHA-256 of its content; the bytes are kept here, in the process.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from simgrab.utilities.parse import Refuse, read_bytes, shown

#: By the endings of their names.
FORMATS = ("glb", "gltf", "obj", "ply", "stl")
MOST_BYTES = 64 * 2**20
"""Of a model and all that it refers to."""
MOST_FILES = 64
MOST_FACES = 500_000
"""Triangles, as often as they are shown; there may be three times as many vertices."""
MOST_JSON_BYTES = 8 * 2**20
MOST_LINES = 4_000_000
"""Of an OBJ file or a material library."""
MOST_NODES, MOST_LEVELS, MOST_MATERIALS = 2_000, 64, 100
"""Of a glTF file."""

_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
_OF_LOOKS = ("KHR_materials_", "KHR_lights_", "KHR_xmp")


class Files(dict[str, bytes]):
    """Files by their names, found by the spellings in which models refer to them."""

    def __missing__(self, key: str) -> bytes:
        found = next((name for name in _spellings(key) if name in self), None)
        if found is None:
            raise KeyError(key)
        return self[found]

    def get(self, key: str, default: Any = None) -> Any:  # noqa: D102
        try:
            return self[key]
        except KeyError:
            return default


def _spellings(name: str) -> list[str]:
    """Names that may be meant: with escapes undone, slashes instead of backslashes, and without options before."""
    plain = [name, unquote(name), name.replace("\\", "/"), *name.split()[-1:]]
    return [str(PurePosixPath(one)) for one in plain]


@dataclass(frozen=True, eq=False)
class Model:
    """A model's file and what it refers to.

    Attributes
    ----------
    name : str
        Of the model's own file.
    files : Files
        The model's own and those that it refers to, each by its path relative to the model's folder.
    missing : tuple of str
        Textures that it refers to and that are not there.
    """

    name: str
    files: Files
    missing: tuple[str, ...] = ()

    @property
    def format(self) -> str:
        """One of `FORMATS`."""
        return self.name.rpartition(".")[2].lower()

    @property
    def data(self) -> bytes:
        """The model's own file."""
        return self.files[self.name]

    @cached_property
    def sha256(self) -> str:
        """Of the file; where it refers to others, of what ``sha256sum`` prints of all, sorted by name."""
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in self.files.items()}
        if len(digests) == 1:
            return next(iter(digests.values()))
        listed = "".join(f"{digests[name]}  {name}\n" for name in sorted(digests))
        return hashlib.sha256(listed.encode()).hexdigest()


def copied(sha256: str) -> str:
    """Folder, within a dataset, of the copy of a model."""
    return f"grabs/{sha256[:12]}"


_known: dict[tuple[str, str], Model] = {}


def remember(model: Model) -> Model:
    """Keep a model for `recall`."""
    return _known.setdefault((model.sha256, model.name), model)


def find(sha256: str, name: str) -> Model | None:
    """Give a model that was read in this process, or in the one that started it."""
    return _known.get((sha256, name))


def recall(sha256: str, name: str, refuse: Refuse) -> Model:
    """Give a model that a scenario names; refuses one that was not read."""
    model = find(sha256, name)
    if model is None:
        raise refuse(
            f"{name}: its content is not known here; read the scene from its file, or from a dataset's manifest"
        )
    return model


def read(path: str | Path, refuse: Refuse) -> Model:
    """Read a model with all that it refers to, and keep it for `recall`.

    Parameters
    ----------
    path : str or Path
    refuse : callable
        From a message to the error that is raised: for what cannot be read, is larger than `MOST_BYTES` together, has
        more than `MOST_FACES` triangles by its own statement, or refers to a file outside its folder.
    """
    path = Path(path)
    _check_name(path.name, refuse)
    files, missing, waiting = (
        Files({path.name: read_bytes(path, refuse, most_bytes=MOST_BYTES)}),
        list[str](),
        [path.name],
    )
    while waiting:
        name = waiting.pop(0)
        about = _about(name, refuse)
        for found in _references(name, files[name], about):
            target = inside(path.parent, found, about)
            key = target.relative_to(path.parent).as_posix()
            if key in files:
                continue
            if len(files) >= MOST_FILES:
                raise refuse(f"{path.name}: refers to more than {MOST_FILES - 1} other files")
            if name.lower().endswith(".mtl") and not target.exists():
                missing.append(found)
                continue
            files[key] = read_bytes(target, about, most_bytes=MOST_BYTES - sum(map(len, files.values())))
            waiting.append(key)
    return of_files(path.name, files, refuse, tuple(missing))


def of_files(name: str, files: Mapping[str, bytes], refuse: Refuse, missing: tuple[str, ...] = ()) -> Model:
    """Keep a model of bytes, with the checks of `read`."""
    _check_name(name, refuse)
    if name not in files or sum(map(len, files.values())) > MOST_BYTES or len(files) > MOST_FILES:
        raise refuse(f"{name}: is not a model of at most {MOST_BYTES >> 20} MiB and {MOST_FILES} files")
    model = Model(name, Files(files), missing)
    _check_counts(model, _about(name, refuse))
    return remember(model)


def _check_name(name: str, refuse: Refuse) -> None:
    ending = name.rpartition(".")[2].lower()
    if ending in ("step", "stp"):
        raise refuse(f"{name}: is a STEP file; convert it by `simgrab grab convert`")
    if ending not in FORMATS:
        raise refuse(f"{name}: must end in one of {', '.join(f'.{ending}' for ending in FORMATS)}")


def _about(name: str, refuse: Refuse) -> Refuse:
    return lambda problem: refuse(f"{name}: {problem}")


def inside(folder: Path, found: str, refuse: Refuse) -> Path:
    """Resolve the name of a file that may not leave a folder, by links neither."""
    name = PurePosixPath(found.replace("\\", "/"))
    target = folder / name
    try:
        leaves = name.is_absolute() or ".." in name.parts or not target.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a NUL byte, a loop of links
        leaves = True
    if leaves or re.match(r"[a-zA-Z]:", found):
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
    elif kind in ("obj", "mtl"):
        if data.count(b"\n") > MOST_LINES:
            raise refuse(f"has more than {MOST_LINES} lines")
        key = rb"(?m)^[ \t]*mtllib[ \t]+(.+)$" if kind == "obj" else rb"(?mi)^[ \t]*map_Kd[ \t]+(.+)$"
        for match in re.finditer(key, data):
            text = match[1].decode("utf-8", errors="replace").strip()
            yield text.split()[-1] if text.startswith("-") else text  # options come before the name
    elif kind == "ply":
        for words in _header(data):
            if len(words) == 3 and words[:2] == ["comment", "TextureFile"]:
                yield words[2]


def _header(data: bytes) -> list[list[str]]:
    """Words of the lines of a PLY file's header."""
    head = data[:100_000].partition(b"end_header")[0]
    return [line.split() for line in head.decode("utf-8", errors="replace").splitlines()]


def gltf(kind: str, data: bytes, refuse: Refuse) -> dict[str, Any]:
    """Read the JSON of a glTF file, or of a GLB's first chunk."""
    if kind == "glb":
        if len(data) < 20 or data[:4] != b"glTF":
            raise refuse("is not a GLB file")
        version, length, chunk, tag = struct.unpack("<4x4I", data[:20])
        if version != 2 or tag != 0x4E4F534A or length > len(data) or 20 + chunk > len(data):
            raise refuse("is truncated, or not a GLB file of version 2")
        data = data[20 : 20 + chunk]
    if len(data) > MOST_JSON_BYTES:
        raise refuse(f"its glTF JSON is larger than {MOST_JSON_BYTES >> 20} MiB")
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise refuse("its glTF is not valid JSON") from None
    if not isinstance(content, dict):
        raise refuse("its glTF is not a JSON object")
    needed = content.get("extensionsRequired", [])
    for extension in needed if isinstance(needed, list) else [needed]:
        if extension in _COMPRESSED:
            raise refuse(f"needs {extension}: export it without compression")
        if not str(extension).startswith(_OF_LOOKS):
            raise refuse(f"needs the glTF extension {shown(extension)}, which is not supported")
    return content


def _tables(content: Mapping[str, Any], name: str, refuse: Refuse) -> list[dict[str, Any]]:
    entries = content.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise refuse(f"its {name} are not a list of JSON objects")
    return entries


def pictures(model: Model, refuse: Refuse) -> Iterator[bytes]:
    """Give all textures of a model, as they lie in its files."""
    about = _about(model.name, refuse)
    if model.format not in ("glb", "gltf"):
        yield from (data for name, data in model.files.items() if name != model.name and not name.endswith(".mtl"))
        return
    content = gltf(model.format, model.data, about)
    views, buffers = _tables(content, "bufferViews", about), _tables(content, "buffers", about)
    for entry in _tables(content, "images", about):
        try:
            uri = entry.get("uri")
            if uri is not None:
                yield _uri(model, uri)
            else:
                view = views[entry["bufferView"]]
                named = buffers[view["buffer"]].get("uri")
                start = 28 + int.from_bytes(model.data[12:16], "little")  # of a GLB's second chunk
                whole = model.data[start:] if named is None else _uri(model, named)
                first = view.get("byteOffset", 0)
                yield whole[first : first + view["byteLength"]]
        except (LookupError, TypeError, ValueError, AttributeError):
            raise about("a texture lies nowhere in its buffers") from None


def _uri(model: Model, uri: str) -> bytes:
    return base64.b64decode(uri.partition(",")[2]) if uri.startswith("data:") else model.files[uri]


def _check_counts(model: Model, refuse: Refuse) -> None:
    """Refuse a model that states more than there may be, before memory is taken for it."""
    data, vertices = model.data, 0
    match model.format:
        case "glb" | "gltf":
            faces, vertices = _shown(gltf(model.format, data, refuse), refuse)
        case "stl":
            binary = len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
            faces = (len(data) - 84) // 50 if binary else len(re.findall(rb"(?i)\bfacet\s+normal\b", data))
            if not binary and not faces:
                raise refuse("is truncated, or not an STL file")
        case "obj":
            corners = [line.count(b" ") for line in re.findall(rb"(?m)^f[ \t].*$", data)]
            faces = sum(max(count - 2, 1) for count in corners)
        case _:
            counts = {words[1]: words[2] for words in _header(data) if words[:1] == ["element"] and len(words) == 3}
            faces, vertices = (_count(counts.get(name, "0"), refuse) for name in ("face", "vertex"))
    if faces > MOST_FACES:
        raise refuse(f"has {faces} triangles or more; the limit is {MOST_FACES}: simplify it")
    if vertices > 3 * MOST_FACES:
        raise refuse(f"states {vertices} vertices; the limit is {3 * MOST_FACES}: simplify it")


def _shown(content: Mapping[str, Any], refuse: Refuse) -> tuple[int, int]:
    """Count triangles and vertices of a glTF file, as often as its nodes show them."""
    for name, most in (("nodes", MOST_NODES), ("materials", MOST_MATERIALS)):
        if len(_tables(content, name, refuse)) > most:
            raise refuse(f"has {len(content[name])} {name}; the limit is {most}")
    nodes = _tables(content, "nodes", refuse)
    _check_levels(nodes, refuse)
    counts = [_count(entry.get("count", 0), refuse) for entry in _tables(content, "accessors", refuse)]
    largest = [0, 0]
    try:
        sizes = [_size(mesh.get("primitives", []), counts) for mesh in _tables(content, "meshes", refuse)]
        shown_by = [sizes[node["mesh"]] for node in nodes if "mesh" in node]
    except (LookupError, TypeError, AttributeError):
        raise refuse("its meshes name accessors that are not there") from None
    for some in (sizes, shown_by):  # a mesh is parsed even where no node shows it
        largest = [max(before, sum(size[i] for size in some)) for i, before in enumerate(largest)]
    return largest[0], largest[1]


def _size(primitives: list[dict[str, Any]], counts: list[int]) -> tuple[int, int]:
    """Count triangles and vertices of a mesh."""
    vertices = [counts[one["attributes"]["POSITION"]] for one in primitives]
    corners = [
        counts[one["indices"]] if "indices" in one else own for one, own in zip(primitives, vertices, strict=True)
    ]
    return sum(corners) // 3, sum(vertices)


def _check_levels(nodes: list[dict[str, Any]], refuse: Refuse) -> None:
    parents: dict[int, int] = {}
    for number, node in enumerate(nodes):
        children = node.get("children", [])
        for child in children if isinstance(children, list) else []:
            if isinstance(child, int):
                parents[child] = number
    for number in parents:
        levels, above = 0, number
        while above in parents:
            above, levels = parents[above], levels + 1
            if levels > MOST_LEVELS:
                raise refuse(f"its nodes are nested in a circle, or more than {MOST_LEVELS} deep")


def _count(value: Any, refuse: Refuse) -> int:
    if isinstance(value, str) and re.fullmatch("[0-9]{1,15}", value):
        value = int(value)
    if not isinstance(value, int) or value < 0:
        raise refuse(f"states a number of elements of {shown(value)}")
    return value
