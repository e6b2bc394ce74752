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
here = [room for room in ROOMS if importlib.util.find_spec(f"simgrab.{room}")]
gone = pytest.mark.skipif(len(here) < len(ROOMS), reason="a room has been deleted")


@gone
def test_the_core_imports_and_lists_its_commands_without_rooms(tmp_path):
    """Without one of them, the others do too: none imports another (`test_fence`)."""
    copy_without(ROOMS, tmp_path)
    assert (
        run(tmp_path, "-c", IMPORTS_ALL, "bench", "paper", "stress", "match", "new", "browse", "studio", "train") == 0
    )


@gone
@pytest.mark.slow
def test_the_tests_of_the_core_pass_without_rooms(tmp_path):
    """Some of them, and all are collected; ``scripts/without_room.py`` runs all."""
    copy_without(ROOMS, tmp_path)
    some = "test_parse or test_every_command_is_in_the_list or test_frames_are_those_that"
    assert run(tmp_path, "-m", "pytest", "-q", "-p", "no:xdist", "-k", some) == 0


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
