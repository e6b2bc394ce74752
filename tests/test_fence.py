"""Imports run downwards only: see the table. The instrument never sees the world, its scenes or MuJoCo."""

import ast
import functools
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

from simgrab.judge.check import cache

PACKAGE = Path(__file__).parents[1] / "simgrab"
# The ground floor, in order: each of these may import only what stands before it.
ORDER = (
    "_version", "text", "errors", "runtime", "io", "model.rng", "model.srgb", "model.geometry", "model.distributions",
    "model.layouts", "model.calibration", "model.records", "reports",
)  # fmt: skip
GROUND = set(ORDER)
MODEL = GROUND | {"model"}
CORE = MODEL | {"world", "instrument", "dataset", "judge", "cli"}
# Rooms that can be taken away: the core imports none of them, and they import only the core.
ROOMS = ("lab", "match", "pages", "training")
# Room: what it may import of simgrab. Labels and scenes are truth: the instrument gets at pictures without them, and so
# do the rivals of the laboratory and what `match` measures of footage.
MAY = {room: set(ORDER[: i + 1]) for i, room in enumerate(ORDER)} | {
    "model": MODEL,
    "instrument": GROUND | {"instrument"},
    "world": MODEL | {"world"},
    "dataset": MODEL | {"world", "dataset"},
    "judge": MODEL | {"world", "instrument", "dataset", "judge"},
    "cli": CORE,
    **{room: CORE | {room} for room in ROOMS},
    "lab.rivals": GROUND | {"instrument", "lab.rivals"},
    "match.footage": GROUND | {"instrument", "match.footage"},
}
FORBIDDEN_TO_INSTRUMENT = {"mujoco", "trimesh", "pyrender", "embreex"}
ONLY_TO_TRAINING = {"torch", "onnx", "onnxscript"}
ONLY_TO_PAGES = {"starlette", "uvicorn"}  # of an extra: to what serves pages


@functools.cache
def imported(source: str) -> set[str]:
    """Dotted names that a module imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide the room"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(name: str, places: set[str]) -> bool:
    """Whether a dotted name, without the package's, lies in one of the places."""
    return any(f"{name}.".startswith(f"{place}.") for place in places)


def violations(room: str, source: str) -> set[str]:
    blind = not within("model.truth", MAY[room]) and within("instrument", MAY[room])
    bad = set()
    for name in imported(source):
        top, _, rest = name.partition(".")
        if top == "simgrab" and not within(rest, MAY[room] | {"__version__"}):
            bad.add(name)
        if blind and top in FORBIDDEN_TO_INSTRUMENT:
            bad.add(name)
        if room != "training" and top in ONLY_TO_TRAINING:
            bad.add(name)
        if room != "pages" and top in ONLY_TO_PAGES:
            bad.add(name)
    if blind:  # these read any column of the labels
        bad |= {name for name in ("read_rows", "read_labels") if name in source}
    return bad


def room_of(path: Path) -> str:
    """The narrowest room of the table that a module of the package lies in."""
    dotted = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    return max((room for room in MAY if within(dotted, {room})), key=len)


FRONT_DOORS = ("__init__.py", "__main__.py", "pytest_plugin.py")


def test_imports_run_downwards():
    found = {}
    for path in PACKAGE.rglob("*.py"):
        relative = path.relative_to(PACKAGE)
        if str(relative) not in FRONT_DOORS:
            found[str(relative)] = violations(room_of(path), path.read_text(encoding="utf-8"))
    assert len(found) > 200
    assert {path: names for path, names in found.items() if names} == {}


def sources():
    """Sources of all modules of the package by dotted name."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path.read_text(encoding="utf-8")
    return found


def check_cycles(sources):
    """Raise graphlib.CycleError where modules import each other, wherever in them."""
    graph = {}
    for module, source in sources.items():
        graph[module] = set()
        for name in imported(source):
            while name and name not in sources:  # a name within a module
                name = name.rpartition(".")[0]
            graph[module] |= {name} - {"", module}
    graphlib.TopologicalSorter(graph).prepare()


def test_no_modules_import_each_other():
    check_cycles(sources())


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("simgrab.errors", "def f():\n    from simgrab.io.parse import read_text"),
        ("simgrab.dataset.manifest", "from simgrab import __version__"),
        ("simgrab.judge.check.report", "from simgrab.judge.check.gate import check"),
    ],
)
def test_a_planted_cycle_is_seen(module, line):
    planted = sources()
    planted[module] += f"\n{line}\n"
    with pytest.raises(graphlib.CycleError):
        check_cycles(planted)


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("instrument", "from simgrab.world.label import label"),
        ("instrument", "from simgrab import scenario"),
        ("instrument", "import mujoco"),
        ("instrument", "from simgrab.model.records import frame_files\nframe_files.read_rows(path, WithAlpha)"),
        ("instrument", "from simgrab.model.records import frame_files\nframe_files.read_labels(path)"),
        ("world", "def f():\n    import simgrab.instrument.estimate"),
        ("world", "from simgrab.judge import audit"),
        ("instrument", "from simgrab.model.truth import Truth"),
        ("instrument", "def f():\n    from simgrab.dataset import datasets"),
        ("instrument", "from simgrab.model import scenes"),
        ("io", "from simgrab.model.geometry import Array"),
        ("reports", "from simgrab import world"),
        ("model.records", "from simgrab.model.truth import Truth"),
        ("model", "from simgrab.world import frames"),
        ("world", "from simgrab.dataset import datasets"),
        ("world", "from simgrab.training import loop"),
        ("instrument", "from simgrab.training import loop"),
        ("judge", "import torch"),
        ("judge", "from simgrab.pages.browse import browse"),
        ("cli", "def f():\n    from simgrab.lab.stress import laboratory"),
        ("lab", "from simgrab.match import scene"),
        ("lab.rivals", "from simgrab.model import scenes"),
        ("match.footage", "import mujoco"),
        ("cli", "import uvicorn"),
    ],
)
def test_a_planted_violation_is_seen(room, line):
    assert violations(room, line)


def test_the_cache_of_checks_goes_by_what_decides_pixels_and_by_nothing_else():
    digested = {room_of(path) for path in cache.drawing_modules() if path.relative_to(PACKAGE).parts[0] not in ROOMS}
    assert {room for room in MAY if within(room, MAY["dataset"])} - {"_version", "reports"} <= digested
    assert not digested & {"instrument", "judge", "cli", "reports", *ROOMS}


@pytest.mark.parametrize(
    ("act", "needless"),
    [
        ("import simgrab", {"mujoco", "OpenGL", "torch", "simgrab.world"}),
        ("import simgrab; simgrab.open(sys.argv[1]).scenario", {"mujoco", "OpenGL", "simgrab.world"}),
        (
            "import simgrab.dataset.render, simgrab.cli.render",
            {"scipy.signal", "scipy.stats", "matplotlib", "onnxruntime", "simgrab.world.trajectory.clip"},
        ),
        (
            "from simgrab.cli import cli; cli(['-h'], standalone_mode=False)",
            {"cv2", "mujoco", "rich", "scipy.linalg", "scipy.optimize", "scipy.special", "trimesh", "yaml"},
        ),
        (  # which every run of pytest loads, where simgrab is installed
            "import simgrab.pytest_plugin",
            {"mujoco", "OpenGL", "torch", "numpy", "cv2", "simgrab.world", "simgrab.judge", "simgrab.instrument"},
        ),
    ],
    ids=["simgrab", "open", "render", "list of commands", "pytest plugin"],
)
def test_what_is_needless_is_not_imported(act, needless, dataset):
    code = f"import sys; {act}; found = {needless} & set(sys.modules); assert not found, found"
    subprocess.run([sys.executable, "-c", code, str(dataset)], check=True, stdout=subprocess.DEVNULL)


def test_mujoco_is_imported_after_its_opengl_is_chosen():
    """`simgrab.world` chooses it; elsewhere nothing may import MuJoCo when a module is imported."""
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] != "world":
            outside = [
                node for node in ast.parse(path.read_text(encoding="utf-8")).body if "mujoco" in ast.unparse(node)
            ]
            assert not any(isinstance(node, ast.Import | ast.ImportFrom) for node in outside), path


def test_drawing_figures_leaves_the_users_backend_alone():
    code = """
import io, matplotlib
matplotlib.rcParams["backend"] = "pdf"
from simgrab.reports.plots import Figure
Figure().savefig(io.BytesIO(), format="png")
assert matplotlib.rcParams["backend"] == "pdf" and "matplotlib.pyplot" not in __import__("sys").modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
