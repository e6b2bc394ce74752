"""Files of 3-D models: the bytes of a model and of all files it refers to, read before anything parses them.

A model may name other files: buffers and textures of glTF, material libraries of OBJ and their textures. They are read
from the model's own folder and from nowhere else, and the parser is given these bytes and no others. A picture or a
material library that is not there is left out, and `ModelFile.missing` names it.
A scenario names a model by its file's name and the SHA-256 of its content; the bytes are kept here, in the process.
"""

from __future__ import annotations

import hashlib
import json
import os
import posixpath
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from simgrab.io.parse import Refuse, read_bytes, shown

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
MOST_NODES, MOST_MATERIALS = 2_000, 100
"""Of a glTF file."""


def _places(name: str, of: str) -> list[str]:
    """Return the paths that a name in a file may mean: in that file's folder, and in the model's."""
    plain = name.replace("\\", "/")
    return list(dict.fromkeys(posixpath.normpath(posixpath.join(*above)) for above in ((of, "..", plain), (plain,))))


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A model's file and the files it refers to."""

    name: str  # name of the model's own file
    # the model's own file and those it refers to, each by its path, with slashes, relative to the model's folder
    files: Mapping[str, bytes]
    missing: tuple[str, ...] = ()  # pictures and material libraries that it refers to but that are not in its folder

    @property
    def format(self) -> str:
        """One of `FORMATS`."""
        return ending(self.name)

    @property
    def data(self) -> bytes:
        """The model's own file."""
        return self.files[self.name]

    def referred(self, name: str, of: str = "") -> bytes | None:
        """Return the file that the model, or another of its files, refers to by a name; None if it is missing."""
        return next((self.files[place] for place in _places(name, of or self.name) if place in self.files), None)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the file. If it refers to others: of the output of ``sha256sum`` for all files, sorted by name."""
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in self.files.items()}
        if len(digests) == 1:
            return next(iter(digests.values()))
        listed = "".join(f"{digests[name]}  {name}\n" for name in sorted(digests))
        return hashlib.sha256(listed.encode()).hexdigest()


def ending(name: str) -> str:
    """Give the ending of a file's name, in lower case, without its dot."""
    return name.rpartition(".")[2].lower()


def check_ending(name: str, endings: Sequence[str], refuse: Refuse) -> None:
    """Refuse a file's name that does not end in one of some ways."""
    if ending(name) not in endings:
        raise refuse(f"{name}: must end in one of {', '.join(f'.{known}' for known in endings)}")


def copied(sha256: str) -> str:
    """Folder of a model's copy within a dataset."""
    return f"grabs/{sha256[:12]}"


_known: dict[tuple[str, str], ModelFile] = {}


def remember(model: ModelFile) -> ModelFile:
    """Keep a model for `recall`."""
    return _known.setdefault((model.sha256, model.name), model)


def find(sha256: str, name: str) -> ModelFile | None:
    """Return a model that was read in this process, or in the process that started it."""
    return _known.get((sha256, name))


def recall(sha256: str, name: str, refuse: Refuse) -> ModelFile:
    """Return a model that a scenario names; refuses a model that was not read."""
    model = find(sha256, name)
    if model is None:
        raise refuse(
            f"{name}: its content is not known here; read the scene from its file, or from a dataset's manifest"
        )
    return model


def read(path: str | Path, refuse: Refuse) -> ModelFile:
    """Read a model with all files it refers to, and keep it for `recall`.

    Parameters
    ----------
    refuse : callable
        Makes the error to raise from a message, for a model that cannot be read, is larger than `MOST_BYTES` in total,
        states more than `MOST_FACES` triangles, or refers to a file outside its folder.
    """
    path = Path(path)
    _check_name(path.name, refuse)
    files = {path.name: read_bytes(path, refuse, most_bytes=MOST_BYTES)}
    missing, waiting = list[str](), [path.name]
    while waiting:
        name = waiting.pop(0)
        about = _about(name, refuse)
        for kind, found in dict.fromkeys(_references(name, files[name], about)):
            target = _target(path.parent, kind, _places(found, name), about)
            if target is None:
                missing.append(found)
                continue
            key = target.relative_to(path.parent).as_posix()
            if key in files:
                continue
            if len(files) >= MOST_FILES:
                raise refuse(f"{path.name}: refers to more than {MOST_FILES - 1} other files")
            files[key] = read_bytes(target, about, most_bytes=MOST_BYTES - sum(map(len, files.values())))
            waiting.append(key)
    return of_files(path.name, files, refuse, tuple(dict.fromkeys(missing)))


def _target(folder: Path, kind: str, places: list[str], refuse: Refuse) -> Path | None:
    """Find the file that another refers to, within the model's folder; None for a missing picture or library."""
    if kind == "picture":  # often named by its path on another machine
        places = [place for place in places if not _leaves(folder, place)]
    targets = [inside(folder, place, refuse) for place in places]
    there = next((target for target in targets if os.path.isfile(target)), None)  # noqa: PTH113 Path's raises
    return targets[-1] if there is None and kind == "buffer" else there  # and what is not there is refused


def of_files(name: str, files: Mapping[str, bytes], refuse: Refuse, missing: tuple[str, ...] = ()) -> ModelFile:
    """Keep a model given as bytes, with the checks of `read`."""
    _check_name(name, refuse)
    if name not in files or sum(map(len, files.values())) > MOST_BYTES or len(files) > MOST_FILES:
        raise refuse(f"{name}: is not a model of at most {MOST_BYTES >> 20} MiB and {MOST_FILES} files")
    model = ModelFile(name, files, missing)
    _check_counts(model, _about(name, refuse))
    return remember(model)


def _check_name(name: str, refuse: Refuse) -> None:
    if ending(name) in ("step", "stp"):
        raise refuse(f"{name}: is a STEP file; convert it by `simgrab grab convert`")
    check_ending(name, FORMATS, refuse)


def _about(name: str, refuse: Refuse) -> Refuse:
    return lambda problem: refuse(f"{name}: {problem}")


def inside(folder: Path, name: str, refuse: Refuse) -> Path:
    """Resolve the name of a file that may not lead out of a folder, not even through links."""
    if _leaves(folder, name):
        raise refuse(f"refers to {shown(name)}, which is outside its folder")
    return folder / PurePosixPath(name.replace("\\", "/"))


def _leaves(folder: Path, found: str) -> bool:
    name = PurePosixPath(found.replace("\\", "/"))
    try:
        leaves = name.is_absolute() or ".." in name.parts
        return bool(
            leaves or re.match("[a-zA-Z]:", found) or not (folder / name).resolve().is_relative_to(folder.resolve())
        )
    except (OSError, ValueError, RuntimeError):  # a NUL byte, a loop of links
        return True


def _references(name: str, data: bytes, refuse: Refuse) -> Iterator[tuple[str, str]]:
    """Return the references of a file: for each, whether it is a buffer, picture or library, and its name."""
    kind = ending(name)
    if kind in ("glb", "gltf"):
        content = gltf(kind, data, refuse)
        for table, what in (("buffers", "buffer"), ("images", "picture")):
            for entry in tables(content, table, refuse):
                uri = entry.get("uri")
                if isinstance(uri, str) and not uri.startswith("data:"):
                    if what == "buffer" and re.match(r"[a-zA-Z][a-zA-Z0-9+.-]*:", uri):
                        raise refuse(f"refers to {shown(uri)}, which is not a file of its folder")
                    yield what, unquote(uri)
    elif kind in ("obj", "mtl"):
        if max(data.count(b"\n"), data.count(b"\r")) > MOST_LINES:
            raise refuse(f"has more than {MOST_LINES} lines")
        if kind == "obj":
            yield from (("library", library) for library in libraries(data))
        else:
            maps = (map_name(value)[0] for key, value in statements(data) if key.lower() == "map_kd")
            yield from (("picture", picture) for picture in maps if picture)
    elif kind == "ply":
        yield from (("picture", texture) for texture in textures(data))


def lines(data: bytes) -> Iterator[str]:
    """Return the non-empty lines of an OBJ or MTL file, stripped, with continued lines joined."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text = re.sub(r"\\[ \t]*\r?\n", " ", text)
    return (line for line in map(str.strip, re.split(r"[\r\n]+", text)) if line and line[0] != "#")


def statements(data: bytes) -> Iterator[tuple[str, str]]:
    """Return the keyword and the rest of each line of an OBJ or MTL file."""
    for line in lines(data):
        key, _, value = line.replace("\t", " ").partition(" ")
        yield key, value.strip()


def libraries(data: bytes) -> list[str]:
    """Return the names of the material libraries of an OBJ file; they may contain spaces."""
    values = [value for key, value in statements(data) if key == "mtllib"] if b"mtllib" in data else []
    listed = (value[:_MOST_OPTIONS].replace('"', "") for value in values)
    return [name for names in listed for name in re.findall(r"(?i)\S.*?\.mtl(?=\s|$)|\S.*", names)]


#: Options of MTL's textures, by the most values that each takes.
MAP_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-texres": 1, "-bm": 1, "-boost": 1, "-imfchan": 1, "-type": 1,
    "-mm": 2, "-o": 3, "-s": 3, "-t": 3,
}  # fmt: skip


_MOST_OPTIONS = 4096  # characters


def map_name(value: str) -> tuple[str, dict[str, list[str]]]:
    """Return the file's name, which may contain spaces, and the options of MTL's ``map_Kd``."""
    options, rest = dict[str, list[str]](), value[:_MOST_OPTIONS].strip()
    while (key := rest.split(maxsplit=1)[0].lower() if rest else "") in MAP_OPTIONS:
        rest, options[key] = rest[len(key) :].lstrip(), []
        while len(options[key]) < MAP_OPTIONS[key]:
            word, _, after = rest.partition(" ")
            if options[key] and not re.fullmatch(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?", word.lower()):
                break  # -o, -s and -t take one to three numbers
            rest = after.lstrip()
            options[key].append(word)
    return rest.strip('"'), options


def textures(data: bytes) -> list[str]:
    """Return the pictures that a PLY file's header names."""
    found = (re.match(r"(?i)comment\s+texturefile\s+(.*\S)", " ".join(words)) for words in header(data))
    return [match[1] for match in found if match]


def header(data: bytes) -> list[list[str]]:
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
    return content


def tables(content: Mapping[str, Any], name: str, refuse: Refuse) -> list[dict[str, Any]]:
    """Return a list of JSON objects of a glTF file."""
    entries = content.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise refuse(f"its {name} are not a list of JSON objects")
    return entries


def _check_counts(model: ModelFile, refuse: Refuse) -> None:
    """Refuse a model that states more than the limits, before memory is allocated for it."""
    data, vertices = model.data, 0
    match model.format:
        case "glb" | "gltf":
            faces, vertices = _shown(gltf(model.format, data, refuse), refuse)
        case "stl":
            binary = len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
            faces = (len(data) - 84) // 50 if binary else len(re.findall(rb"(?i)\bfacet\s+normal\b", data))
            if not binary and not faces:
                raise refuse("is truncated, or not an STL file")
        case "obj":
            corners = (len(line.split()) - 1 for line in re.findall(rb"(?m)^[ \t]*fo?[ \t].*$", data))
            faces, vertices = sum(max(count - 2, 1) for count in corners), len(re.findall(rb"(?m)^[ \t]*v[ \t]", data))
        case _:
            counts = {words[1]: words[2] for words in header(data) if words[:1] == ["element"] and len(words) == 3}
            faces = _count(counts.get("face", "0"), refuse)
            vertices = max((_count(count, refuse) for count in counts.values()), default=0)
    if faces > MOST_FACES:
        raise refuse(f"has {faces} triangles or more; the limit is {MOST_FACES}: simplify it")
    if vertices > 3 * MOST_FACES:
        raise refuse(f"states {vertices} vertices or other elements; the limit is {3 * MOST_FACES}: simplify it")


def _shown(content: Mapping[str, Any], refuse: Refuse) -> tuple[int, int]:
    """Count triangles and vertices of a glTF file, once for each time a node shows them."""
    for name, most in (("nodes", MOST_NODES), ("materials", MOST_MATERIALS)):
        if len(tables(content, name, refuse)) > most:
            raise refuse(f"has {len(content[name])} {name}; the limit is {most}")
    counts = [_count(entry.get("count", 0), refuse) for entry in tables(content, "accessors", refuse)]
    try:
        sizes = [_size(mesh.get("primitives", []), counts) for mesh in tables(content, "meshes", refuse)]
        shown_by = [sizes[node["mesh"]] for node in tables(content, "nodes", refuse) if "mesh" in node]
    except (LookupError, TypeError, AttributeError):
        raise refuse("its meshes name accessors that are not there") from None
    # A mesh is parsed even where no node shows it.
    faces, vertices = (max(sum(size[i] for size in some) for some in (sizes, shown_by)) for i in range(2))
    return faces, vertices


def _size(primitives: list[dict[str, Any]], counts: list[int]) -> tuple[int, int]:
    """Count triangles and vertices of a mesh; a primitive without any counts too, for it takes time."""
    vertices = [counts[one["attributes"]["POSITION"]] for one in primitives]
    corners = [
        counts[one["indices"]] if "indices" in one else own for one, own in zip(primitives, vertices, strict=True)
    ]
    of_strips = (5, 6)  # modes that have a triangle for each corner
    faces = (n if one.get("mode") in of_strips else n // 3 for n, one in zip(corners, primitives, strict=True))
    return sum(faces), sum(max(n, 1) for n in vertices)


def _count(value: Any, refuse: Refuse) -> int:
    if isinstance(value, str) and re.fullmatch("[0-9]{1,15}", value):
        value = int(value)
    if not isinstance(value, int) or value < 0:
        raise refuse(f"states a number of elements of {shown(value)}")
    return value
