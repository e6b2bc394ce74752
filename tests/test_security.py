"""What SECURITY.md claims of the code as a whole; claims of one room are tested in that room."""

import ast
import json
from pathlib import Path

import pytest
import trimesh

from simgrab.errors import ScenarioError
from simgrab.io.resources import ASSETS, SCENES
from simgrab.model import scenario, scenes

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "simgrab"
# What makes objects or runs code out of bytes that may be a user's.
MODULES = {
    "pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "code", "codeop", "runpy",
    "pty", "yaml", "ruamel",
}  # fmt: skip
SAFE = {"yaml": {"safe_load", "YAMLError"}}  # names of them that make nothing but numbers, texts, lists and mappings
BUILTINS = {"eval", "exec", "compile", "__import__"}
# Modules that users name by --instrument or --estimator, in suites and in studies; and our own by name.
IMPORTERS = {
    "__init__.py", "cli/_verbs.py", "instrument/estimate/__init__.py", "runtime/modules.py", "world/gl.py",
}  # fmt: skip


PIPES = "runtime/processes.py"  # between a command and its workers, whose items are pickled


def name_of(node):
    """Dotted name of what is called."""
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def executes(source, path=""):
    """What in a module may make objects or run code out of a file."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            safe = isinstance(node, ast.ImportFrom) and {alias.name for alias in node.names} <= SAFE.get(
                names[0], set()
            )
            found |= {name for name in names if name.split(".")[0] in MODULES and not safe}
        if not isinstance(node, ast.Call):
            continue
        name = name_of(node.func)
        given = {word.arg: getattr(word.value, "value", None) for word in node.keywords}
        last = name.rpartition(".")[2]
        if name in BUILTINS or name in ("os.system", "os.popen", "importlib.util.spec_from_file_location"):
            found.add(name)
        if last == "import_module" and path not in IMPORTERS:
            found.add(name)
        if last in ("loads", "load") and "Pickler" in name and path != PIPES:
            found.add(name)
        if name.startswith("torch") and last in ("load", "jit.load") and given.get("weights_only") is not True:
            found.add(name)
        if name in ("np.load", "numpy.load") and given.get("allow_pickle") is not False:
            found.add(name)
        if given.get("shell") or (given.get("allow_pickle") and last != "save"):
            found.add(name)
        if last == "read_pickle" or name == "np.lib.format.read_array":
            found.add(name)
    return found


def test_no_file_is_executed():
    modules = {str(path.relative_to(PACKAGE)): path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    assert len(modules) > 200
    found = {path: executes(source, path) for path, source in modules.items()}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    "line",
    [
        "import pickle", "from pickle import loads", "import yaml", "from yaml import safe_load, load",
        "from yaml import *", "import joblib", "eval(text)", "exec(text)",
        "torch.load(path)", "torch.load(path, weights_only=False)", "np.load(path)", "np.load(path, allow_pickle=True)",
        "os.system(text)", "subprocess.run(text, shell=True)", "importlib.import_module(text)", "pd.read_pickle(path)",
        "ForkingPickler.loads(data)", "reduction.ForkingPickler.loads(data)",
        "def f():\n    import dill",
    ],
)  # fmt: skip
def test_a_planted_execution_is_seen(line):
    assert executes(line)


def texts(node, path=""):
    """Places of a JSON schema that take any text."""
    if isinstance(node, list):
        return set().union(*(texts(one, path) for one in node))
    if not isinstance(node, dict):
        return set()
    free = node.get("type") == "string" and not {"enum", "const", "pattern"} & set(node)
    return ({path} if free else set()).union(*(texts(value, f"{path}.{key}") for key, value in node.items()))


def test_a_scene_names_no_file_but_a_grab_a_photograph_or_a_font(tmp_path):
    places = {path.removeprefix(".$defs.") for path in texts(scenario.schema())}
    assert places == {
        "Display.properties.layout.anyOf",  # bundled, tested below
        "Display.properties.start",  # a time
        "FontFile.properties.file",  # tested in tests/world/test_display_font.py
        "Jaw.properties.node",  # of a grab's file
        "Mesh.properties.file",  # tested below
        "Photo.properties.file",  # tested in tests/world/test_photo.py
        "OneOf.properties.names.items",  # what a choice is called
        "Scenario.properties.base",  # bundled, tested below
        "Scenario.properties.description",
    }
    mine = tmp_path / "mine.toml"
    mine.write_text((SCENES / "calm-day.toml").read_text(encoding="utf-8"), encoding="utf-8")
    scenes.load(mine)
    for line in (f'base = "{mine}"', 'base = "../scenes/calm-day"'):
        (tmp_path / "other.toml").write_text(line, encoding="utf-8")
        with pytest.raises(ScenarioError, match=r"base: .*no bundled scene"):
            scenes.load(tmp_path / "other.toml")
    layout = ASSETS / "osd" / "two-by-four.toml"
    for name in (layout, "../osd/two-by-four"):
        with pytest.raises(ScenarioError, match="layout must be one of"):
            scenes.load("calm-day", {"display.layout": str(name)})


ELSEWHERE = ("../a.stl", "{outer}/a.stl", "link.stl", "../inner/../a.stl")


@pytest.fixture
def scene_of(tmp_path):
    """Writes a scene file in an inner folder that names a model; there is one outside, and links to it."""
    (tmp_path / "inner").mkdir()
    for file in ("a.stl", "inner/a.stl"):
        trimesh.creation.box((2, 2, 2)).export(tmp_path / file)
    (tmp_path / "inner" / "link.stl").symlink_to(tmp_path / "a.stl")

    def written(file):
        scene = tmp_path / "inner" / "scene.toml"
        scene.write_text(f'[grab]\nmodel = "mesh"\nfile = "{file}"', encoding="utf-8")
        return scene

    return written


@pytest.mark.parametrize("file", ELSEWHERE)
def test_a_file_that_a_scene_names_may_lie_anywhere(scene_of, tmp_path, file):
    scenario = scenes.load(scene_of(file.format(outer=tmp_path)))
    assert scenario.grab.file == file.rpartition("/")[2]
    assert str(tmp_path) not in str(scenario.to_dict())


@pytest.mark.parametrize("file", [*ELSEWHERE, "b\\u0000.stl"])
def test_a_folder_that_files_may_not_leave(scene_of, tmp_path, file):
    scene = scene_of(file.format(outer=tmp_path))
    with pytest.raises(ScenarioError, match=r"grab\.file: .*outside of .*inner"):
        scenes.load(scene, within=tmp_path / "inner")
    assert scenes.load(scene_of("a.stl"), within=tmp_path / "inner").grab.file == "a.stl"


@pytest.mark.parametrize(
    "file", ["b\\u0000.stl", "", "..", "/", ".", "none.stl", "../../../../none.stl", "/etc/passwd"]
)
def test_a_path_to_nothing_of_use_is_refused_in_one_line(scene_of, file):
    with pytest.raises(ScenarioError, match=r"grab\.file|file") as refused:
        scenes.load(scene_of(file))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("file", ["../../a.stl", "{outer}/a.stl", "../a.stl"])
def test_a_manifest_names_no_file_outside_its_dataset(scene_of, tmp_path, file):
    data = scenes.load(scene_of("a.stl")).to_dict()
    data["grab"]["file"] = file.format(outer=tmp_path)
    (tmp_path / "inner" / "manifest.json").write_text(json.dumps({"scenario": data}), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"grab\.file: .*(outside its folder|No such file)"):
        scenes.load(tmp_path / "inner" / "manifest.json")
