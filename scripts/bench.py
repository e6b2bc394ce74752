"""Measure simgrab on this machine. Ratios are taken pair by pair within one run, so that a noisy machine cancels.

python -m scripts.bench render [--pairs 30] [--memory-frames 2000]
python -m scripts.bench renderers [--blender PYTHON] [--size 1920x1080] [--frames 10] [--pictures FOLDER]
python -m scripts.bench estimate
python -m scripts.bench motion
python -m scripts.bench stress
python -m scripts.bench world
python -m scripts.bench scale [--scene training] [--size WIDTHxHEIGHT] [--frames 48]
python -m scripts.bench detect [--yolo FILE.onnx]
python -m scripts.bench run VIDEO [--detector bundled] [--frames 20000] [--live-frames 1000]

Each takes --json FILE, which keeps every sample with machine, versions and commit. Two such files are compared with

python -m scripts.bench --compare A.json B.json
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from pathlib import Path
from typing import Any

from scripts import bench_compare, bench_results
from simgrab.errors import SimgrabError

VERBS = ("render", "renderers", "estimate", "motion", "stress", "world", "scale", "detect", "run")
"""``world`` is the function of that name in ``scripts.bench_world``, imported when asked for: imports take memory."""


def main(arguments: list[str] | None = None) -> int:
    """Measure, or compare two files. Returns the exit status: 2 where something given is wrong, in one line."""
    parser = _parser()
    options = vars(parser.parse_args(arguments))
    compared, verb = options.pop("compare"), options.pop("verb")
    if bool(compared) == bool(verb):
        parser.error("give a verb, or --compare A.json B.json")
    try:
        if compared:
            for line in bench_compare.compare(*map(bench_results.load, compared)):
                print(line)
        else:
            _measure(verb, options.pop("json"), options)
    except SimgrabError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    return 0


def _measure(verb: str, out: Path | None, options: dict[str, Any]) -> None:
    if out and out.is_dir():  # before minutes of measuring
        raise bench_results.ResultsError(f"cannot write {out}: it is a folder")
    measured = []
    act = getattr(importlib.import_module(f"scripts.bench_{verb}"), verb)
    for quantity in act(**options):
        print(quantity, flush=True)
        measured.append(quantity)
    from scripts import bench_machine  # after measuring, because it opens renderers

    results = bench_machine.of_this_run(verb, options, tuple(measured))
    print(f"{results.commit}, {', '.join(results.machine.values())}")
    if out:
        results.save(out)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m scripts.bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--compare", nargs=2, type=Path, metavar=("A", "B"), help="compare two files of results")
    verbs = parser.add_subparsers(dest="verb")
    by_name = {name: verbs.add_parser(name) for name in VERBS}
    for verb in by_name.values():
        verb.add_argument("--json", type=Path, metavar="FILE", help="keep the results")
    by_name["render"].add_argument("--pairs", type=_count, default=30)
    by_name["render"].add_argument("--memory-frames", type=int, default=2000)
    by_name["renderers"].add_argument("--blender", metavar="PYTHON", help="an interpreter that can import bpy")
    by_name["renderers"].add_argument("--size", type=_size, default=(1920, 1080))
    by_name["renderers"].add_argument("--frames", type=_count, default=10)
    by_name["renderers"].add_argument("--pictures", type=Path, metavar="FOLDER", help="where each writes one picture")
    by_name["scale"].add_argument("--scene", default="training")
    by_name["scale"].add_argument("--size", type=_size, help="px; the scene's own unless given")
    by_name["scale"].add_argument("--frames", type=_count, default=48)
    by_name["detect"].add_argument("--yolo", type=Path, help="another detector beside the bundled one")
    by_name["run"].add_argument("video", type=Path)
    by_name["run"].add_argument("--detector", default="bundled")
    by_name["run"].add_argument("--frames", type=_count, default=20_000)
    by_name["run"].add_argument("--live-frames", type=_count, default=1000)
    return parser


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not int(text):
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 1, got {text!r}")
    return int(text)


def _size(text: str) -> tuple[int, int]:
    if not re.fullmatch(r"[1-9][0-9]{0,4}x[1-9][0-9]{0,4}", text):
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT in pixels, got {text!r}")
    width, _, height = text.partition("x")
    return int(width), int(height)


if __name__ == "__main__":
    sys.exit(main())
