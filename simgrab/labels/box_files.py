"""YOLO's and COCO's layouts of boxes, as trainers and annotation tools write them."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from simgrab.errors import DatasetError, first_line, one_line
from simgrab.geometry import Array
from simgrab.labels.masks import MOST_COCO_BYTES
from simgrab.utilities.parse import is_dir, is_file, read_bytes, read_text, read_yaml, shown
from simgrab.utilities.pictures import SUFFIXES

YAML = "data.yaml"
MOST_YAML_BYTES = 2**20
SPLIT_NAMES = {
    "train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val", "test": "test",
    "testing": "test",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Image:
    """An image and its boxes.

    Attributes
    ----------
    file : str
        Relative to the dataset, with forward slashes.
    split : str
        As the dataset names it; empty where it names none.
    where : str
        What messages call the labels.
    boxes : tuple of (str, ndarray of shape (4,))
        Class, and x0, y0, x1, y1 in the unit that ``shares`` states.
    shares : bool
        Whether boxes are in shares of the image, not in px.
    size : tuple of 2 int, optional
        Width and height that the labels state, px.
    """

    file: str
    split: str
    where: str
    boxes: tuple[tuple[str, Array], ...]
    shares: bool
    size: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class Layout:
    """A parsed dataset: its folder, its classes, and its images by file."""

    root: Path
    classes: tuple[str, ...]
    images: tuple[Image, ...]


def parse(path: Path) -> Layout:
    """Parse a folder, a ``data.yaml`` or a COCO file. A folder with a ``data.yaml`` is YOLO's.

    Raises
    ------
    DatasetError
    """
    if path.suffix.lower() == ".json":
        return _coco(path.parent.parent if path.parent.name == "annotations" else path.parent, [path])
    if path.suffix.lower() in (".yaml", ".yml"):
        return _yolo(path.parent, path)
    if not is_dir(path, DatasetError):
        raise DatasetError(f"{path}: a folder in YOLO's or COCO's layout, a data.yaml or a COCO .json is needed")
    if is_file(path / YAML, DatasetError):
        return _yolo(path, path / YAML)
    found = next((some for pattern in _COCO_FILES if (some := sorted(path.glob(pattern)))), [])
    return _coco(path, found) if found else _yolo(path, None)


def _within(root: Path, path: Path, where: object) -> Path:
    """Path of a file below the dataset's folder; refuse one that leads out of it, by its name or as a link."""
    folder, normal = Path(os.path.abspath(root)), Path(os.path.abspath(path))  # noqa: PTH100
    try:
        os.path.relpath(normal, folder).encode()
        real = Path(os.path.realpath(normal)).is_relative_to(os.path.realpath(folder))
    except (OSError, ValueError) as problem:  # a NUL byte, or a name that is no UTF-8
        raise DatasetError(f"{where} names {path}: {first_line(problem)}") from None
    if not (real and normal.is_relative_to(folder)):
        raise DatasetError(f"{where} names {path}, which is not in the dataset {root}")
    return root / normal.relative_to(folder)


# YOLO ------------------------------------------------------------------------------------------------------------


def _yolo(root: Path, description: Path | None) -> Layout:
    """Parse images with text labels. An image without a label file, or with an empty one, shows no class."""
    about = {} if description is None else _description(description)
    names = _names(about, description)
    files = _listed(root, about, description) if description else _found(root, root)
    unique: dict[Path, str] = {}
    for split, file in files:
        if unique.setdefault(file, split) != split:
            unique[file] = ""  # where val names train's folder, no split is named
    images, labelled, used = [], 0, set[str]()
    for file in sorted(unique):
        text = _label_file(root, file)
        has_labels = is_file(text, DatasetError)
        labelled += has_labels
        boxes = tuple(_lines(_within(root, text, file), names)) if has_labels else ()
        used |= {name for name, _ in boxes}
        images.append(Image(file.relative_to(root).as_posix(), unique[file], str(text), boxes, shares=True))
    if images and not labelled:
        raise DatasetError(f"{root}: no image has a label file, such as {images[0].where}")
    return Layout(root, tuple(names.values()) if names else tuple(sorted(used)), tuple(images))


def _description(path: Path) -> dict[str, Any]:
    data = read_yaml(path, DatasetError, most_bytes=MOST_YAML_BYTES)
    if not isinstance(data, dict):
        raise DatasetError(f"{path}: keys such as train, val and names are needed")
    return data


def _names(about: Mapping[str, Any], path: Path | None) -> dict[int, str]:
    """Names of the classes by number; none where they are not named."""
    names = about.get("names")
    if names is None and path is None:
        return {}
    if isinstance(names, list):
        names = dict(enumerate(names))
    if not isinstance(names, dict) or not all(
        isinstance(key, int) and isinstance(name, str | int) for key, name in names.items()
    ):
        raise DatasetError(f"{path}: names must list the classes")
    return {key: str(name) for key, name in sorted(names.items())}


def _listed(root: Path, about: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Path]]:
    """Images of the folders and lists that a ``data.yaml`` names."""
    if not isinstance(about.get("path", ""), str | None):
        raise DatasetError(f"{path}: path must be text")
    base = _within(root, root / (about.get("path") or "."), f"{path}: path")
    keys = [key for key in about if str(key).lower() in SPLIT_NAMES and about[key]]
    if not keys:
        raise DatasetError(f"{path}: it names no train, val or test")
    for key in keys:
        for entry in about[key] if isinstance(about[key], list) else [about[key]]:
            if not isinstance(entry, str):
                raise DatasetError(f"{path}: {key} must name folders or lists")
            inner = entry.removeprefix("../")  # Roboflow's begin so, though the folders lie beside the file
            stripped = inner if is_dir(base / inner, DatasetError) else entry
            place = _within(root, base / stripped, f"{path}: {key}")
            split = SPLIT_NAMES[str(key).lower()]
            if is_dir(place, DatasetError):
                yield from ((split, file) for _, file in _found(root, place))
                continue
            if place.suffix != ".txt":
                raise DatasetError(f"{path}: {key} names {shown(entry)}, which is neither a folder nor a .txt list")
            for line in read_text(place, DatasetError).split("\n"):
                if line.strip():
                    yield split, _within(root, base / line.strip(), place)


def _found(root: Path, folder: Path) -> Iterator[tuple[str, Path]]:
    """Images in a folder and below, with the split that the name of a folder gives."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in SUFFIXES and not path.name.startswith("."):
            file = _within(root, path, folder)
            words = [part.lower() for part in file.relative_to(root).parts[:-1]]
            yield next((SPLIT_NAMES[word] for word in words if word in SPLIT_NAMES), ""), file


def _label_file(root: Path, image: Path) -> Path:
    """Label file of an image: in ``labels`` in place of the last ``images`` of its path, or else beside it."""
    parts = list(image.relative_to(root).parts)
    if "images" in parts[:-1]:
        parts[len(parts) - 2 - parts[-2::-1].index("images")] = "labels"
    return root.joinpath(*parts).with_suffix(".txt")


def _lines(path: Path, names: Mapping[int, str]) -> Iterator[tuple[str, Array]]:
    """Boxes of a label file: in each line ``class x y width height``, or ``class`` and a polygon's ``x y`` in turn."""
    for number, line in enumerate(read_text(path, DatasetError).splitlines(), 1):
        values = line.split()
        if not values:
            continue
        where = f"{path}: line {number}"
        try:
            which, numbers = int(values[0]), np.array(values[1:], float)
            if which < 0 or len(numbers) < 4 or len(numbers) % 2:  # of a box, or of three corners and more
                raise ValueError
        except ValueError:
            raise DatasetError(f"{where}: expected 'class x y width height' or a polygon, got {shown(line)}") from None
        if names and which not in names:
            raise DatasetError(f"{where}: class {which} is not among the {len(names)} names of the classes")
        if len(numbers) == 4:
            middle, half = numbers[:2], numbers[2:] / 2
            box = np.concatenate([middle - half, middle + half])
        else:
            points = numbers.reshape(-1, 2)
            box = np.concatenate([points.min(axis=0), points.max(axis=0)])
        yield names.get(which, str(which)), box


# COCO ------------------------------------------------------------------------------------------------------------

_COCO_FILES = ("annotations/instances*.json", "annotations/*.json", "*.coco.json", "*/*.coco.json", "*.json")


class _CocoImage(msgspec.Struct, frozen=True):
    id: int
    file_name: str
    width: int
    height: int


class _CocoBox(msgspec.Struct, frozen=True):
    image_id: int
    category_id: int
    bbox: tuple[float, float, float, float]


class _CocoCategory(msgspec.Struct, frozen=True):
    id: int
    name: str


class _Coco(msgspec.Struct, frozen=True):
    images: tuple[_CocoImage, ...]
    annotations: tuple[_CocoBox, ...]
    categories: tuple[_CocoCategory, ...]


def _coco(root: Path, paths: list[Path]) -> Layout:
    """Parse COCO files, of one split each, as far as their names or their folders' name one."""
    images, classes = dict[str, Image](), dict[str, None]()
    for path in paths:
        known = _instances(path)
        classes |= dict.fromkeys(category.name for category in known.categories)
        for image in _coco_images(root, path, known):
            if image.file in images:
                raise DatasetError(f"{path}: {image.file} is an image of {images[image.file].where} too")
            images[image.file] = image
    return Layout(root, tuple(classes), tuple(image for _, image in sorted(images.items())))


def _instances(path: Path) -> _Coco:
    data = read_bytes(path, DatasetError, most_bytes=MOST_COCO_BYTES).removeprefix(codecs.BOM_UTF8)
    try:
        return msgspec.json.decode(data, type=_Coco)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as problem:
        raise DatasetError(f"{path}: not readable COCO labels ({one_line(problem)})") from None


def _coco_images(root: Path, path: Path, known: _Coco) -> Iterator[Image]:
    names = {category.id: category.name for category in known.categories}
    boxes: dict[int, list[tuple[str, Array]]] = {image.id: [] for image in known.images}
    for one in known.annotations:
        if one.image_id not in boxes or one.category_id not in names:
            what = "image" if one.image_id not in boxes else "category"
            number = one.image_id if what == "image" else one.category_id
            raise DatasetError(f"{path}: an annotation is of {what} {number}, which is not listed")
        x, y, width, height = one.bbox
        boxes[one.image_id].append((names[one.category_id], np.array([x, y, x + width, y + height])))
    for image in known.images:
        file = _coco_file(root, path, image.file_name)
        yield Image(
            file.relative_to(root).as_posix(), _coco_split(root, path), f"{path}: image {shown(image.file_name)}",
            tuple(boxes[image.id]), shares=False, size=(image.width, image.height),
        )  # fmt: skip


def _coco_split(root: Path, path: Path) -> str:
    """Split that the words of a file's name, or its folder in the dataset, name; else none."""
    words = re.findall("[a-z]+", path.stem.lower())
    if path.parent != root:
        words.append(path.parent.name.lower())
    return next((SPLIT_NAMES[word] for word in words if word in SPLIT_NAMES), "")


def _coco_file(root: Path, path: Path, name: str) -> Path:
    """Find an image: below the dataset, its folder ``images``, the folder of the split, or beside the file."""
    last = path.stem.split("_")[-1]
    for folder in (root, root / "images", root / last, root / "images" / last, path.parent):
        if is_file(folder / name, DatasetError):
            return _within(root, folder / name, path)
    raise DatasetError(f"{path}: the image {shown(name)} is missing")
