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
    "_version", "text", "errors", "rng", "utilities", "geometry", "distributions", "layouts", "calibration", "records",
    "pages",
)  # fmt: skip
GROUND = set(ORDER)
SCENARIO = GROUND | {"scenario", "scenes"}
# Room: what it may import of simgrab. The labels are truth: the instrument gets at pictures without them.
MAY = {room: set(ORDER[: i + 1]) for i, room in enumerate(ORDER)} | {
    "scenario": SCENARIO,
    "scenes": SCENARIO,
    "labels": SCENARIO | {"labels"},
    "instrument": GROUND | {"instrument"},
    "world": SCENARIO | {"labels", "world"},
    "judge": SCENARIO | {"labels", "world", "instrument", "judge"},
    "training": SCENARIO | {"labels", "world", "instrument", "training"},
    "browse": SCENARIO | {"labels", "world", "instrument", "judge", "browse"},
    "studio": SCENARIO | {"labels", "world", "instrument", "studio"},
    "cli": SCENARIO | {"labels", "world", "instrument", "judge", "training", "browse", "studio", "cli"},
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


def violations(room: str, source: str) -> set[str]:
    allowed = MAY[room]
    bad = set()
    for name in imported(source):
        top, _, rest = name.partition(".")
        if top == "simgrab" and rest.split(".")[0] not in allowed | {"__version__"}:
            bad.add(name)
        if room == "instrument" and top in FORBIDDEN_TO_INSTRUMENT:
            bad.add(name)
        if room != "training" and top in ONLY_TO_TRAINING:
            bad.add(name)
        if room not in ("pages", "browse", "studio") and top in ONLY_TO_PAGES:
            bad.add(name)
    if room == "instrument" and "read_rows" in source:  # which reads any column of the labels
        bad.add("read_rows")
    return bad


FRONT_DOORS = ("__init__.py", "__main__.py", "pytest_plugin.py")


def test_imports_run_downwards():
    found = {}
    for path in PACKAGE.rglob("*.py"):
        relative = path.relative_to(PACKAGE)
        if str(relative) not in FRONT_DOORS:
            room = relative.parts[0].removesuffix(".py")
            found[str(relative)] = violations(room, path.read_text(encoding="utf-8"))
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
        ("simgrab.errors", "def f():\n    from simgrab.utilities.parse import read_text"),
        ("simgrab.world.output.manifest", "from simgrab import __version__"),
        ("simgrab.judge.stress.page", "from simgrab.judge.stress.laboratory import run"),
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
        ("instrument", "from simgrab.records import frame_files\nframe_files.read_rows(path, WithAlpha)"),
        ("world", "def f():\n    import simgrab.instrument.estimate"),
        ("world", "from simgrab.judge import audit"),
        ("instrument", "from simgrab.labels.truth import Truth"),
        ("instrument", "def f():\n    from simgrab.labels import datasets"),
        ("utilities", "from simgrab.geometry import Array"),
        ("pages", "from simgrab import world"),
        ("labels", "from simgrab.world import frames"),
        ("world", "from simgrab.training import loop"),
        ("instrument", "from simgrab.training import loop"),
        ("judge", "import torch"),
        ("judge", "from simgrab.browse import browse"),
        ("cli", "import uvicorn"),
    ],
)
def test_a_planted_violation_is_seen(room, line):
    assert violations(room, line)


def test_the_cache_of_checks_goes_by_no_room_that_the_world_may_not_import():
    assert set(MAY) - MAY["world"] <= set(cache.ELSEWHERE)


def test_import_touches_no_opengl():
    code = "import sys, simgrab; assert not {'mujoco', 'OpenGL', 'torch', 'simgrab.world'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_mujoco_is_imported_after_its_opengl_is_chosen():
    """`simgrab.world` chooses it; elsewhere nothing may import MuJoCo when a module is imported."""
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] != "world":
            outside = [
                node for node in ast.parse(path.read_text(encoding="utf-8")).body if "mujoco" in ast.unparse(node)
            ]
            assert not any(isinstance(node, ast.Import | ast.ImportFrom) for node in outside), path


def test_rendering_starts_without_what_only_other_scenes_and_commands_need():
    needless = {"scipy.signal", "scipy.stats", "matplotlib", "onnxruntime", "simgrab.world.trajectory.clip"}
    code = f"import sys, simgrab.world.output.dataset, simgrab.cli.render; assert not {needless} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_list_of_commands_starts_without_what_only_the_commands_need():
    needless = {"cv2", "mujoco", "rich", "scipy.linalg", "scipy.optimize", "scipy.special", "trimesh", "yaml"}
    code = "import sys; from simgrab.cli import cli; cli(['-h'], standalone_mode=False); "
    code += f"assert not {needless} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_drawing_figures_leaves_the_users_backend_alone():
    code = """
import io, matplotlib
matplotlib.rcParams["backend"] = "pdf"
from simgrab.pages.plots import Figure
Figure().savefig(io.BytesIO(), format="png")
assert matplotlib.rcParams["backend"] == "pdf" and "matplotlib.pyplot" not in __import__("sys").modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_pytest_plugin_is_light():
    # Every run of pytest loads it, where simgrab is installed.
    heavy = {"mujoco", "OpenGL", "torch", "numpy", "cv2", "simgrab.world", "simgrab.judge", "simgrab.instrument"}
    code = f"import sys, simgrab.pytest_plugin; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
