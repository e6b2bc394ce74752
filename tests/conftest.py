import contextlib
import fcntl
import gc
import hashlib
import importlib.util
import json
import os
import shutil
import signal

import pyarrow.parquet as pq
import pytest

from scripts.without_room import ROOMS
from simgrab.model import scenes

# Started in the background or by nohup, tests inherit signals that are ignored, and so would the commands they start.
with contextlib.suppress(ValueError):  # not in the main thread
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Documents describe every room: where one has been deleted, they are not tested.
collect_ignore = [] if all(importlib.util.find_spec(f"simgrab.{room}") for room in ROOMS) else ["documents"]

# A picture a sixteenth of the size, drawn without antialiasing: labels are computed the same way.
SMALL = {
    "camera.width_px": 480,
    "camera.height_px": 270,
    "camera.focal": {"model": "pixels", "focal_length_px": 411.2},
    "image.samples": 0,
    "image.shadow_map_px": 1024,
    "place": {"model": "plain"},
    "frames": 6,
}
# Everything that a camera can have at once.
CROOKED = {
    "camera.beta_deg": 6.5,
    "camera.tilt_azimuth_deg": 70.0,
    "camera.roll_deg": -25.0,
    "camera.offset_x_m": 0.4,
    "camera.offset_y_m": -0.7,
    "camera.offset_z_m": -0.5,
    "camera.principal_offset_px": [5.0, -3.0],
    "camera.distortion": {"k1": -0.28, "k2": 0.09, "p1": 5e-4, "p2": -8e-4, "k3": -0.01},
    "swing.alpha.sigma_deg": 4.0,
}


def pytest_addoption(parser):
    for mark in ("slow", "long"):
        parser.addoption(f"--{mark}", action="store_true", help=f"run the tests marked {mark} too")


def pytest_collection_modifyitems(config, items):
    left_out = [mark for mark in ("slow", "long") if not config.getoption(f"--{mark}")]
    some = {item for item in items if any(map(item.get_closest_marker, left_out))}
    config.hook.pytest_deselected(items=list(some))
    items[:] = [item for item in items if item not in some]


def pytest_collection_finish():
    """Leave modules and tests, which stay, out of each later collection of garbage."""
    gc.freeze()


def toml(value):
    """Write a value as TOML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
    return "[" + ", ".join(map(toml, value)) + "]" if isinstance(value, list) else json.dumps(value)


def as_options(changes):
    """Command-line arguments that make the same changes."""
    return [part for key, value in changes.items() for part in ("--set", f"{key}={toml(value)}")]


def by_yolo(folder, split, *, oriented=False):
    """Number, BGR picture and detections of a split's frames, as a trainer's loader reads them."""
    supervision = pytest.importorskip("supervision")
    loaded = supervision.DetectionDataset.from_yolo(
        images_directory_path=str(folder / "images" / split),
        annotations_directory_path=str(folder / "labels" / split),
        data_yaml_path=str(folder / "data.yaml"),
        is_obb=oriented,
    )
    assert loaded.classes == ["grab"]
    for path, picture, detections in loaded:
        yield int(path.rsplit("/", 1)[1].split(".")[0]), picture, detections


def digests(folder, stem=""):
    """Digest of every file in a folder, by what follows the stem in its path there."""
    files = ((str(p.relative_to(folder)), p) for p in sorted(folder.rglob("*")) if p.is_file())
    return {
        name.removeprefix(stem): hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in files if name.startswith(stem)
    }  # fmt: skip


def altered(path, column, change):
    """Rewrite a column of a dataset's labels."""
    table = pq.read_table(path / "labels.parquet")
    place = table.schema.get_field_index(column)
    values = change(table[column].to_pylist())
    pq.write_table(table.set_column(place, column, [values]), path / "labels.parquet")


def slow_but(cases, *fast):
    """Cases of a parametrized test, all but ``fast`` of them marked slow."""
    return [
        case if case in fast else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]


def small_scene(name="quay-day", **changes):
    return scenes.load(name, SMALL | {key.replace("__", "."): value for key, value in changes.items()})


@pytest.fixture(scope="session", autouse=True)
def no_wait_for_the_disk():
    """Files need not survive a power failure, and what processes see of them is the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def scene():
    return small_scene()


@pytest.fixture(scope="session")
def crooked_scene():
    return scenes.load("quay-day", SMALL | CROOKED)


def rendered_once(tmp_path_factory, name, scene):
    """A dataset of a scene that all worker processes of pytest share; copy it before changing it."""
    from simgrab.dataset.render import render

    here = tmp_path_factory.getbasetemp()
    path = (here.parent if "PYTEST_XDIST_WORKER" in os.environ else here) / "shared" / name
    path.parent.mkdir(exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            render(scene, path.with_suffix(".draft"), resume=True)
            path.with_suffix(".draft").rename(path)
    return path


@pytest.fixture(scope="session")
def dataset(scene, tmp_path_factory):
    """A finished small dataset; copy it before changing it."""
    return rendered_once(tmp_path_factory, "small", scene)


@pytest.fixture
def copy(dataset, tmp_path):
    """A copy of the small dataset, to be changed."""
    return shutil.copytree(dataset, tmp_path / "copy")


@pytest.fixture(scope="session")
def halves(dataset, tmp_path_factory):
    """The small dataset, four frames to learn from and two to judge by, one of which shows nothing."""
    path = shutil.copytree(dataset, tmp_path_factory.mktemp("halves") / "data")
    altered(path, "split", lambda splits: ["train" if i < 4 else "val" for i in range(len(splits))])
    nothing = {f"box_{e}_px": None for e in ("x0", "y0", "x1", "y1")} | {"visible_fraction": 0.0, "present": False}
    for column, value in nothing.items():
        altered(path, column, lambda values, value=value: [*values[:5], value])
    return path


@pytest.fixture(scope="session")
def crooked_dataset(crooked_scene, tmp_path_factory):
    return rendered_once(tmp_path_factory, "crooked", crooked_scene)


@pytest.fixture(scope="session")
def split_dataset(tmp_path_factory):
    """Frames in every split, of which some show little or nothing of the grab."""
    law = {"dist": "choice", "values": [0.0, 1.0]}
    thirds = {"train": 0.34, "val": 0.33, "test": 0.33}
    changes = {"swing.alpha": {"sigma_deg": 15.0, "law": law}, "swing.absent": 0.3, "splits": thirds}
    return rendered_once(
        tmp_path_factory, "split", scenes.load("quay-day", SMALL | changes | {"frames": 12, "seed": 4})
    )
