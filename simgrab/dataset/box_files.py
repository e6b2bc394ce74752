"""YOLO's and COCO's layouts of boxes, as trainers and annotation tools write them."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from simgrab.errors import DatasetError, first_line
from simgrab.io import pictures
from simgrab.io.files import is_visible
from simgrab.io.parse import is_dir, is_file, read_bytes, read_text, read_yaml, shown
from simgrab.model.geometry import Array
from simgrab.model.masks import MOST_COCO_BYTES, parsed

YAML = "data.yaml"
MOST_YAML_BYTES = 2**20
SPLIT_NAMES = {
    "train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val", "test": "test",
    "testing": "test",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class BoxedImage:
    """An image, by its path in the dataset with forward slashes, and its boxes."""

    file: str
    split: str  # as the dataset names it; empty where it names none
    where: str  # what messages call the labels
    # (4,), class, and x0, y0, x1, y1 in px or, with `shares`, in shares of the image
    boxes: tuple[tuple[str, Array], ...]
    shares: bool
    size: tuple[float, float] | None = None  # width and height that the labels state, px
    crowds: frozenset[str] = frozenset()  # classes of which a region shows several that are not distinguished


@dataclass(frozen=True, eq=False)
class BoxDataset:
    """A parsed dataset: its folder, its classes, and its images by file."""

    root: Path
    classes: tuple[str, ...]
    images: tuple[BoxedImage, ...]


def parse(path: Path) -> BoxDataset:
    """Parse a folder, a ``data.yaml`` or a COCO file. A folder with a ``data.yaml`` is YOLO's."""
    if path.suffix.lower() == ".json":
        return _coco(path.parent.parent if path.parent.name == "annotations" else path.parent, [path])
    if path.suffix.lower() in (".yaml", ".yml"):
        return _yolo(path.parent, path)
    if not is_dir(path, DatasetError):
        raise DatasetError(f"{path}: a folder in YOLO's or COCO's layout, a data.yaml or a COCO .json is needed")
    if is_file(path / YAML, DatasetError):
        return _yolo(path, path / YAML)
    found = next((some for pattern in _COCO_FILES if (some := _matching(path, pattern))), [])
    return _coco(path, found) if found else _yolo(path, None)


def _within(root: Path, path: Path, where: object) -> Path:
    """Path of a file below the dataset's folder; refuse a path that leads out of it, by its name or through a link."""
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

_TASKS_OF_POLYGONS = ("segment", "obb")
_OUTSIDE = 0.01  # of the image, by which rounding may put a box or a point outside
_SKEW = 0.005  # of the image, by which rounding may bend a parallelogram


def _yolo(root: Path, description: Path | None) -> BoxDataset:
    """Parse images with text labels. An image without a label file, or with an empty one, shows no class."""
    about: Any = {} if description is None else read_yaml(description, DatasetError, most_bytes=MOST_YAML_BYTES)
    if not isinstance(about, dict):
        raise DatasetError(f"{description}: keys such as train, val and names are needed")
    names, key_points = _names(about, description), _key_points(about, description)
    files = _listed(root, about, description) if description else _found(root, root)
    unique: dict[Path, str] = {}
    for split, file in files:
        if unique.setdefault(file, split) != split:
            unique[file] = ""  # where val names train's folder, no split is named
    texts = {file: _label_file(root, file) for file in sorted(unique)}
    lines = {
        file: tuple(_lines(_within(root, text, file), names, key_points))
        for file, text in texts.items() if is_file(text, DatasetError)
    }  # fmt: skip
    if texts and not lines:
        raise DatasetError(
            f"{root}: no image has a label file, such as {next(iter(texts.values()))}; put label "
            "files beside the images, or into a folder labels instead of images"
        )
    if key_points is None and about.get("task") not in _TASKS_OF_POLYGONS:
        _refuse_key_points([numbers for some in lines.values() for _, numbers in some], root)
    images = [
        BoxedImage(
            file.relative_to(root).as_posix(), unique[file], str(text),
            tuple((name, _box(numbers, key_points)) for name, numbers in lines.get(file, ())), shares=True,
        )
        for file, text in texts.items()
    ]  # fmt: skip
    used = {name for some in lines.values() for name, _ in some}
    return BoxDataset(root, tuple(names.values()) if names else tuple(sorted(used)), tuple(images))


def _names(about: Mapping[str, Any], path: Path | None) -> dict[int, str]:
    """Names of the classes by number; none where they are not named."""
    names = about.get("names")
    if names is None and path is None:
        return {}
    if isinstance(names, list):
        names = dict(enumerate(names))
    if isinstance(names, dict):
        names = {
            int(key) if isinstance(key, str) and key.isdecimal() else key: names[key] for key in sorted(names, key=str)
        }
    if not isinstance(names, dict) or not all(
        type(key) is int and isinstance(name, str | int) for key, name in names.items()
    ):
        raise DatasetError(f"{path}: names must list the classes, such as [grab] or {{0: grab}}")
    return {key: str(name) for key, name in sorted(names.items())}


def _key_points(about: Mapping[str, Any], path: Path | None) -> tuple[int, int] | None:
    """Read how many key points follow a box, and how many values each has; None if not stated."""
    shape = about.get("kpt_shape")
    if shape is None:
        return None
    if not (isinstance(shape, list) and [type(n) for n in shape] == [int, int] and shape[0] > 0 and shape[1] in (2, 3)):
        raise DatasetError(f"{path}: kpt_shape must be [number of key points, 2 or 3], got {shown(shape)}")
    return shape[0], shape[1]


def _listed(root: Path, about: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Path]]:
    """Images of the folders and lists that a ``data.yaml`` names."""
    base = _base(root, about.get("path") or ".", f"{path}: path")
    keys = [key for key in about if str(key).lower() in SPLIT_NAMES and about[key]]
    if not keys:
        raise DatasetError(f"{path}: train, val and test are all missing")
    for key in keys:
        for entry in about[key] if isinstance(about[key], list) else [about[key]]:
            if not isinstance(entry, str):
                raise DatasetError(f"{path}: {key} must name folders or lists")
            inner = _joined(base, entry.removeprefix("../"))  # Roboflow's begin so, though they lie beside the file
            place = inner if is_dir(inner, DatasetError) else _joined(base, entry)
            place = _within(root, place, f"{path}: {key}")
            split = SPLIT_NAMES[str(key).lower()]
            if is_dir(place, DatasetError):
                yield from ((split, file) for _, file in _found(root, place))
                continue
            if place.suffix != ".txt":
                raise DatasetError(f"{path}: {key} names {shown(entry)}, which is neither a folder nor a .txt list")
            for line in read_text(place, DatasetError).split("\n"):
                if line.strip():
                    yield split, _within(root, _first([base, place.parent, Path()], line.strip()), place)


def _base(root: Path, stated: object, where: str) -> Path:
    """Folder that a ``data.yaml`` states, relative to the file or, as trainers read it, to the working folder."""
    if not isinstance(stated, str):
        raise DatasetError(f"{where} must be text")
    base = _first([root, Path()], stated)
    if not is_dir(base, DatasetError):
        raise DatasetError(f"{where} names {shown(stated)}, which is not a folder; without this key, {root} is used")
    return _within(root, base, where)


def _first(folders: Iterable[Path], name: str) -> Path:
    """Path that a file names: in the first folder that contains it, or else in the first folder."""
    paths = [_joined(folder, name) for folder in folders]
    return next((path for path in paths if os.path.lexists(path)), paths[0])


def _joined(folder: Path, name: str) -> Path:
    """Path that a file names, maybe with the backslashes of Windows."""
    path = folder / name
    return path if "\\" not in name or os.path.lexists(path) else folder / name.replace("\\", "/")


def _found(root: Path, folder: Path) -> Iterator[tuple[str, Path]]:
    """Images in a folder and its subfolders, each with the split that a folder's name gives."""
    for path in pictures.of(folder, below=True):
        file = _within(root, path, folder)
        words = [part.lower() for part in file.relative_to(root).parts[:-1]]
        yield next((SPLIT_NAMES[word] for word in words if word in SPLIT_NAMES), ""), file


def _label_file(root: Path, image: Path) -> Path:
    """Label file of an image: the last ``images`` in its path replaced by ``labels``, or else beside the image."""
    parts = list(image.relative_to(root).parts)
    if "images" in parts[:-1]:
        parts[len(parts) - 2 - parts[-2::-1].index("images")] = "labels"
    path = root.joinpath(*parts)
    upper = path.with_suffix(".TXT")
    return upper if is_file(upper, DatasetError) else path.with_suffix(".txt")


def _lines(path: Path, names: Mapping[int, str], key_points: tuple[int, int] | None) -> Iterator[tuple[str, Array]]:
    """Lines of a label file: the class, and what follows it.

    That is ``x y width height`` and maybe key points, or ``x y`` in turn of a polygon's corners.
    """
    for number, line in enumerate(read_text(path, DatasetError).splitlines(), 1):
        if not line.strip():
            continue
        where = f"{path}: line {number}"
        try:
            which, *numbers = map(_number, line.split())
            if which < 0 or not which.is_integer():
                raise ValueError(f"a class must be a whole number, got {which:g}")
            if problem := _miscounted(len(numbers), key_points):
                raise ValueError(f"{len(numbers)} values after the class {problem}")
        except ValueError as problem:
            raise DatasetError(
                f"{where}: expected 'class x y width height' or a polygon, got {shown(line)}: {problem}"
            ) from None
        if names and which not in names:
            raise DatasetError(f"{where}: class {which:g} is not among the {len(names)} names of the classes")
        yield names.get(int(which), f"{which:.0f}"), np.array(numbers)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{shown(text)} is not a number") from None


def _miscounted(count: int, key_points: tuple[int, int] | None) -> str:
    """Return why a line cannot have this number of values after its class; empty if it can."""
    if key_points is not None:
        known, each = key_points
        whole = 4 + known * each
        return "" if count in (4, whole) else f"do not fit kpt_shape [{known}, {each}], with which there are {whole}"
    if count < 4:
        return "are too few"
    if count == 5:
        return "are one too many: a label has no confidence and no angle"
    if count % 2:
        return "are an odd number; if they are a box and key points, state kpt_shape in data.yaml"
    return ""


def _refuse_key_points(rows: Iterable[Array], root: Path) -> None:
    """Refuse lines that may be boxes with key points: equally long lines that each begin with a box in the image."""
    longer = [row for row in rows if len(row) > 4]
    counts = {len(row) for row in longer}
    if len(counts) != 1:
        return
    values, (count,) = np.array(longer), counts
    corners = values.reshape(len(values), -1, 2)
    if count == 8 and (np.abs(corners[:, 0] - corners[:, 1] + corners[:, 2] - corners[:, 3]) < _SKEW).all():
        return  # oriented boxes
    middle, half = values[:, :2], values[:, 2:4] / 2
    if not (half > 0).all() or not _in_image(middle - half) or not _in_image(middle + half):
        return
    shapes = []
    for each in (2, 3):
        points = values[:, 4:]
        if points.shape[1] % each == 0:
            points = points.reshape(len(values), -1, each)
            if _in_image(points[..., :2]) and np.isin(points[..., 2:], (0, 1, 2)).all():
                shapes.append(f"'kpt_shape: [{points.shape[1]}, {each}]'")
    if shapes:
        raise DatasetError(
            f"{root}: the {count} values after a class may be a polygon, or a box and key points; write "
            f"'task: segment' or {' or '.join(shapes)} into {YAML}, whichever is right"
        )


def _in_image(points: Array) -> bool:
    return bool(((points >= -_OUTSIDE) & (points <= 1 + _OUTSIDE)).all())


def _box(numbers: Array, key_points: tuple[int, int] | None) -> Array:
    """Box as x0, y0, x1, y1, or the bounding box of a polygon."""
    if len(numbers) == 4 or key_points is not None:
        middle, half = numbers[:2], numbers[2:4] / 2
        return np.concatenate([middle - half, middle + half])
    corners = numbers.reshape(-1, 2)
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)])


# COCO ------------------------------------------------------------------------------------------------------------

_COCO_FILES = ("annotations/instances*.json", "annotations/*.json", "*.coco.json", "*/*.coco.json", "*.json")
_Id = int | float | str  # 1, 1.0 and "1" are the same


class _CocoImage(msgspec.Struct, frozen=True):
    id: _Id
    file_name: str
    width: int | float | None = None
    height: int | float | None = None


class _CocoBox(msgspec.Struct, frozen=True):
    image_id: _Id
    category_id: _Id
    bbox: tuple[float, float, float, float]
    iscrowd: bool | int = 0


class _CocoCategory(msgspec.Struct, frozen=True):
    id: _Id
    name: str


_Listed = TypeVar("_Listed", _CocoImage, _CocoCategory)


class _Coco(msgspec.Struct, frozen=True):
    images: tuple[_CocoImage, ...]
    annotations: tuple[_CocoBox, ...]
    categories: tuple[_CocoCategory, ...]


def _matching(folder: Path, pattern: str) -> list[Path]:
    return sorted(path for path in folder.glob(pattern) if is_visible(path, folder))


def _coco(root: Path, paths: list[Path]) -> BoxDataset:
    """Parse COCO files. Each has one split, if its name or its folder's name states one."""
    images, classes = dict[str, BoxedImage](), dict[str, None]()
    for path in paths:
        data = read_bytes(path, DatasetError, most_bytes=MOST_COCO_BYTES).removeprefix(codecs.BOM_UTF8)
        known = parsed(data, _Coco, path)
        classes |= dict.fromkeys(category.name for category in known.categories)
        for image in _coco_images(root, path, known):
            if image.file in images:
                raise DatasetError(f"{path}: {image.file} is also an image of {images[image.file].where}")
            images[image.file] = image
    return BoxDataset(root, tuple(classes), tuple(image for _, image in sorted(images.items())))


def _coco_images(root: Path, path: Path, known: _Coco) -> Iterator[BoxedImage]:
    names, images = _by_id(known.categories, f"{path}: category"), _by_id(known.images, f"{path}: image")
    boxes: dict[str, list[tuple[str, Array]]] = {key: [] for key in images}
    crowds: dict[str, set[str]] = {key: set() for key in images}
    for one in known.annotations:
        image, category = _key(one.image_id), _key(one.category_id)
        if image not in images or category not in names:
            what = f"category {category}" if image in images else f"image {image}"
            raise DatasetError(f"{path}: an annotation is of {what}, which is not listed")
        if one.iscrowd:
            crowds[image].add(names[category].name)
            continue
        x, y, width, height = one.bbox
        boxes[image].append((names[category].name, np.array([x, y, x + width, y + height])))
    for key, about in images.items():
        file = _coco_file(root, path, about.file_name)
        size = None if about.width is None or about.height is None else (about.width, about.height)
        yield BoxedImage(
            file.relative_to(root).as_posix(), _coco_split(root, path), f"{path}: image {shown(about.file_name)}",
            tuple(boxes[key]), shares=False, size=size, crowds=frozenset(crowds[key]),
        )  # fmt: skip


def _by_id(things: Iterable[_Listed], where: str) -> dict[str, _Listed]:
    found: dict[str, _Listed] = {}
    for thing in things:
        if found.setdefault(_key(thing.id), thing) is not thing:
            raise DatasetError(f"{where} {_key(thing.id)} is listed twice")
    return found


def _key(number: _Id) -> str:
    return f"{number:.0f}" if isinstance(number, float) and number.is_integer() else str(number)


def _coco_split(root: Path, path: Path) -> str:
    """Split named in a file's name or in its folder's name; empty if neither names one."""
    words = re.findall("[a-z]+", path.stem.lower())
    if path.parent != root:
        words.append(path.parent.name.lower())
    return next((SPLIT_NAMES[word] for word in words if word in SPLIT_NAMES), "")


def _coco_file(root: Path, path: Path, name: str) -> Path:
    """Find an image: below the dataset, its folder ``images``, the folder of the split, or beside the file."""
    last = path.stem.split("_")[-1]
    for folder in (root, root / "images", root / last, root / "images" / last, path.parent):
        if is_file(file := _joined(folder, name), DatasetError):
            return _within(root, file, path)
    raise DatasetError(f"{path}: the image {shown(name)} is missing")
