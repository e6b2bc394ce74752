"""A room can be deleted: the core imports, lists its commands and passes its tests without it."""

import ast
import importlib.util

import pytest

from scripts.without_room import ROOMS, ROOT, copy_without, run

IMPORTS_ALL = """
import importlib, pathlib, sys, simgrab, simgrab.cli
package = pathlib.Path(simgrab.__file__).parent
assert package.parent == pathlib.Path.cwd(), package
for path in package.rglob("*.py"):
    name = ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__")
    if not name.startswith("simgrab.training") and path.stem != "__main__":
        importlib.import_module(name)
verbs = simgrab.cli.cli.list_commands(None)
assert "render" in verbs and not {*sys.argv[1:]} & {*verbs}, verbs
for verb in verbs:
    assert simgrab.cli.cli.get_command(None, verb).help
"""
# Of each room: its commands.
VERBS = {"lab": ["bench", "paper", "stress"], "match": ["match"], "pages": ["browse", "studio"], "training": ["train"]}
here = [room for room in ROOMS if importlib.util.find_spec(f"simgrab.{room}")]
gone = pytest.mark.skipif(len(here) < len(ROOMS), reason="a room has been deleted")


@gone
@pytest.mark.parametrize("rooms", [ROOMS, *(pytest.param((room,), marks=pytest.mark.slow) for room in ROOMS)])
def test_the_core_imports_and_lists_its_commands_without_rooms(rooms, tmp_path):
    copy_without(rooms, tmp_path)
    assert run(tmp_path, "-c", IMPORTS_ALL, *(verb for room in rooms for verb in VERBS[room])) == 0


@gone
@pytest.mark.slow
def test_the_tests_of_the_core_pass_without_rooms(tmp_path):
    """Some of them, and all are collected; ``scripts/without_room.py`` runs all."""
    copy_without(ROOMS, tmp_path)
    assert run(tmp_path, "-m", "pytest", "-q", "-p", "no:xdist", "--collect-only", "tests") == 0
    some = ("tests/test_fence.py", "tests/test_parse.py", "tests/cli/test_cli.py", "tests/world/test_frames.py")
    assert run(tmp_path, "-m", "pytest", "-q", "-p", "no:xdist", *some) == 0


@gone
def test_a_planted_use_of_a_room_is_seen(tmp_path):
    copy_without(ROOMS, tmp_path)
    with (tmp_path / "simgrab" / "judge" / "doctor.py").open("a") as module:
        module.write("\nfrom simgrab.lab.stress import laboratory\n")
    assert run(tmp_path, "-c", IMPORTS_ALL) != 0


def test_tests_import_no_other_room_when_they_are_collected():
    found = []
    for path in (ROOT / "tests").rglob("*.py"):
        others = {*ROOMS} - {path.relative_to(ROOT / "tests").parts[0]}
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                words = ast.unparse(node).replace(",", " ").split()
                found += [(path, word) for word in words for room in others if word.startswith(f"simgrab.{room}")]
    assert found == []
