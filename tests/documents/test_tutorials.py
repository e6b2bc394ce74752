"""The tutorials run: their files and commands in order, from an empty folder, with the output that they show."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted(TUTORIALS.glob("*.md"))}
FENCE = re.compile(
    r"(?:<!-- not run: (?P<reason>[^\n]+) -->\n)?"
    r'```(?P<language>\w+)(?: title="(?P<title>[\w./-]+)")?\n(?P<text>.*?)```',
    re.DOTALL,
)
STATUS = re.compile(r"\s+# exit status (\d+)$")


def fences(page):
    return list(FENCE.finditer(page))


def matches(shown, printed):
    """Whether an output is as shown: … stands for anything, and decimals may differ by 5 %, or 0.02."""
    shown, printed = (re.sub(r"[ \t]+", " ", re.sub(r"[─━]+", "─", text)).strip() for text in (shown, printed))
    parts = re.split(r"(…|\d+\.\d+)", shown)
    literal = [".*" if part == "…" else r"(\d+\.\d+)" if i % 2 else re.escape(part) for i, part in enumerate(parts)]
    found = re.fullmatch("".join(literal), printed, re.DOTALL)
    wanted = [float(part) for part in parts[1::2] if part != "…"]
    return found is not None and [float(one) for one in found.groups()] == pytest.approx(wanted, rel=0.05, abs=0.02)


def run(command, folder):
    """Exit status, output and error output of ``simgrab …`` or ``python FILE …``."""
    program, *arguments = command
    start = ["-c", "from simgrab.cli import main; main()"] if program == "simgrab" else []
    env = os.environ | {"XDG_CACHE_HOME": str(folder / "cache")}
    command = [sys.executable, *start, *arguments]
    found = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=300, check=False)
    return found.returncode, found.stdout, found.stderr


@pytest.mark.long
@pytest.mark.parametrize("name", PAGES)
def test_a_tutorial_gives_what_it_shows(name, tmp_path):
    printed = None
    for fence in fences(PAGES[name]):
        text = fence["text"]
        if fence["title"]:
            (tmp_path / fence["title"]).write_text(text, encoding="utf-8")
        elif fence["language"] == "bash":
            printed = None if fence["reason"] else ["", ""]
            for line in text.splitlines() if printed else ():
                wanted = STATUS.search(line)
                status, *streams = run(shlex.split(STATUS.sub("", line)), tmp_path)
                assert status == (int(wanted[1]) if wanted else 0), streams[1]
                printed = ["".join(parts) for parts in zip(printed, streams, strict=True)]
        elif printed:
            assert any(matches(text, stream) for stream in printed), f"{printed[0]}\nis not\n{text}"


@pytest.mark.parametrize("name", PAGES)
def test_every_fence_is_a_file_a_command_or_output(name):
    for fence in fences(PAGES[name]):
        assert fence["title"] or fence["language"] in ("bash", "text"), fence["text"]
        if fence["language"] == "bash" and not fence["reason"]:
            assert {shlex.split(line)[0] for line in fence["text"].splitlines()} <= {"simgrab", "python"}
    assert PAGES[name].count("```") == 2 * len(fences(PAGES[name]))


def test_wrong_output_is_found():
    assert matches("found 3.20 of …\n│ a │ 1 │", "found 3.21  of 17\n│ a   │ 1 │")
    assert not matches("found 3.2", "found 3.6")
    assert not matches("found 3", "found 4")
    assert not matches("found 3", "found 3\nand more")
