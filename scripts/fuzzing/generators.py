"""How inputs of each kind are made: by replacing values in sound files, and by damaging their bytes."""

from __future__ import annotations

import json
import os
import re
import shutil
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from scripts.fuzzing import bytewise, corpus, documents, nets, tables
from simgrab.io.resources import SCENES
from simgrab.judge.check import suite
from simgrab.lab.stress import catalogue
from simgrab.model import layouts, scenes

# Names that a user's files may have; without suffix.
NAMES = (
    "a b", "a\nb", "\x1b[31mred", "\udcff\udcfe", "é", "年月日", "-x", "%05d", "a'b\"c", "x" * 200, "[ab]*", "#?&",
    "{0}", "\u202eb", "a\tb", "\u2028", "$HOME", "~",
)  # fmt: skip

Made = tuple[str, Mapping[str, bytes]]
"""Suffix, and files by name. A single one without a name is opened; of several, their folder is."""


@dataclass(frozen=True)
class Case:
    """One input: the files that a user would hand to simgrab."""

    kind: str
    number: int  # among the inputs of its kind
    generator: str  # "structure" or "bytes"
    content: Mapping[str, bytes]  # by path below the folder that they are written to, with surrogates for no UTF-8
    target: str  # the file or folder among them that simgrab opens

    def write(self, folder: Path) -> None:
        """Write all files below a folder."""
        for name, data in self.content.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)

    def keep(self, folder: Path, report: str) -> Path:
        """Write it and what went wrong into a folder; returns the file or folder that was opened."""
        shutil.rmtree(folder, ignore_errors=True)
        self.write(folder / "input")
        (folder / "report.txt").write_text(report, encoding="utf-8", errors="backslashreplace")
        return folder / "input" / self.target


@dataclass(frozen=True)
class Kind:
    """A kind of input."""

    structured: Callable[[Random], Made] | None  # makes every second input of random numbers
    seeds: tuple[Made, ...]  # sound ones for the byte mutator
    damaged: tuple[str, ...] = ()  # names of the files that it may damage; empty for all


def _alone(suffix: str, data: bytes) -> Made:
    return suffix, {"": data}


def _documents(suffix: str, found: list[Any]) -> Kind:
    """Kind of a TOML or JSON file."""
    write = documents.as_json if suffix == ".json" else documents.as_toml
    seeds = tuple(_alone(suffix, write(one).encode()) for one in found)
    return Kind(lambda rng: _alone(suffix, documents.hostile(rng, found, write)), seeds)


def _toml(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _scenario() -> Kind:
    whole = [scenes.load(name).to_dict() for name in ("quay-day", "free-swing", "work-cycles", "digits")]
    return _documents(".toml", [*(_toml(SCENES / f"{name}.toml") for name in scenes.names()), *whole, *whole])


def _set() -> Kind:
    """Arguments of ``--set``, one after another with NUL bytes between them."""
    flat = dict(_dotted(scenes.load("quay-day").to_dict()))

    def joined(rng: Random) -> Made:
        keys = [rng.choice(sorted(flat)) for _ in range(rng.randint(1, 3))]
        text = "\0".join(f"{key}={documents.inline(documents.changed(rng, flat[key]))}" for key in keys)
        encodable = re.sub("[\ud800-\udc7f\udd00-\udfff]", "?", text)  # what no bytes of an argument are decoded to
        return _alone(".txt", os.fsencode(encodable))

    seeds = (
        b"camera.beta_deg=5.0", b"swing.alpha.sigma_deg=2\0frames=3", b'camera.mount={model="fixed"}',
        b"display.start=2022-01-26",
    )  # fmt: skip
    return Kind(joined, tuple(_alone(".txt", data) for data in seeds))


def _dotted(table: Mapping[str, Any], head: str = "") -> Iterator[tuple[str, Any]]:
    """Give each key of tables within tables, with its value."""
    for key, value in table.items():
        yield f"{head}{key}", value
        if isinstance(value, dict):
            yield from _dotted(value, f"{head}{key}.")


def _folder(sound: Mapping[str, bytes], names: tuple[str, ...], end: str = "") -> Kind:
    """Kind of a folder, of which one of the named files is changed or missing; ``end`` is what is opened in it."""

    def structured(rng: Random) -> Made:
        name = rng.choice(names)
        rest = {other: data for other, data in sound.items() if other != name}
        return end, rest if rng.random() < 0.1 else rest | {name: near(rng, name)}

    def near(rng: Random, name: str) -> bytes:
        data = sound[name]
        if name.endswith(".parquet"):
            return tables.parquet(rng, data)
        if name.endswith(".json"):
            return documents.hostile(rng, [json.loads(data)], documents.as_json)
        return documents.hostile(rng, [tomllib.loads(data.decode())], documents.as_toml)

    return Kind(structured, ((end, sound),), names)


def _content(folder: Path, keep: Callable[[str], bool]) -> dict[str, bytes]:
    paths = ((str(path.relative_to(folder)), path) for path in sorted(folder.rglob("*")) if path.is_file())
    return {name: path.read_bytes() for name, path in paths if keep(name)}


def _run(made: Path) -> Kind:
    names = ("run.json", "alarms.json", "camera.toml", "angles.parquet")
    folders = (made / corpus.RUN, made / corpus.RUN_OF_VIDEO)
    kinds = [_folder(_content(folder, lambda file: file != "angles.csv"), names) for folder in folders]
    makers = [kind.structured for kind in kinds if kind.structured]
    return Kind(lambda rng: rng.choice(makers)(rng), tuple(seed for kind in kinds for seed in kind.seeds), names)


def _truth(made: Path) -> Kind:
    sound = {f"x{end}": (made / f"swing{end}").read_bytes() for end in (".parquet", ".manifest.json")}
    return _folder(sound, tuple(sound), "x.parquet")


def _dataset(made: Path) -> Kind:
    names = ("labels.parquet", "manifest.json")
    return _folder(_content(made / corpus.DATASET, lambda file: file in names or file.startswith("images/")), names)


def _table(made: Path) -> Kind:
    csv, parquet = (made / corpus.RECORD).read_bytes(), (made / corpus.DATASET / "labels.parquet").read_bytes()
    seeds = (_alone(".csv", csv), _alone(".parquet", parquet))
    return Kind(lambda rng: _alone(".parquet", tables.parquet(rng, parquet)), seeds)


def _picture(made: Path) -> Kind:
    """Folder of a picture beside a sound one."""
    sound = next(iter(sorted((made / corpus.DATASET).glob("images/*/*.jpg")))).read_bytes()
    seeds = (("", {f"1{suffix}": data, "0.jpg": sound}) for suffix, data in [(".jpg", sound), *corpus.pictures()])
    return Kind(None, tuple(seeds))


def _video(made: Path) -> Kind:
    seeds = [(".mp4", (made / corpus.VIDEO).read_bytes()), *corpus.videos()]
    return Kind(None, tuple(_alone(*one) for one in seeds))


def _baseline() -> Kind:
    found = [_json(path) for path in sorted((suite.FOLDER / "baselines").glob("*/baseline.json"))]
    (smoke,) = (one for one in found if one["suite"] == "smoke")
    return _folder({"baseline.json": json.dumps(smoke).encode()}, ("baseline.json",))


KINDS: dict[str, Callable[[Path], Kind]] = {
    "scenario": lambda _: _scenario(),
    "manifest": lambda made: _documents(
        ".json", [_json(made / corpus.DATASET / "manifest.json"), _json(made / "swing.manifest.json")]
    ),
    "set": lambda _: _set(),
    "camera": lambda made: _documents(".toml", [_toml(made / corpus.CAMERA), _toml(made / "swing.camera.toml")]),
    "layout": lambda _: _documents(".toml", [_toml(layouts.FOLDER / f"{name}.toml") for name in layouts.names()]),
    "tilt": lambda made: _documents(".toml", [_toml(made / corpus.TILT)]),
    "suite": lambda _: _documents(".toml", [_toml(suite.FOLDER / f"{name}.toml") for name in suite.names()]),
    "baseline": lambda _: _baseline(),
    "study": lambda _: _documents(".toml", [_toml(catalogue.STUDIES / f"{name}.toml") for name in catalogue.names()]),
    "run": _run,
    "truth": _truth,
    "dataset": _dataset,
    "table": _table,
    "picture": _picture,
    "video": _video,
    "detector": lambda _: Kind(
        lambda rng: _alone(".onnx", nets.net(rng)), tuple(map(partial(_alone, ".onnx"), nets.seeds()))
    ),
}


def cases(name: str, count: int, seed: int, made: Path) -> Iterator[Case]:
    """Make inputs of a kind, from a folder of `corpus.make`; the same for the same seed and versions of libraries."""
    kind = KINDS[name](made)
    for number in range(count):
        rng = Random(f"{seed}/{name}/{number}")
        if number % 2 or kind.structured is None:
            suffix, sound = rng.choice(kind.seeds)
            file = rng.choice(kind.damaged or tuple(sorted(sound)))
            others = [files[file] for _, files in kind.seeds if file in files]
            damaged = {**sound, file: bytewise.mutate(sound[file], rng, others)}
            yield Case(name, number, "bytes", *_placed((suffix, damaged), rng))
        else:
            yield Case(name, number, "structure", *_placed(kind.structured(rng), rng))


def _placed(made: Made, rng: Random) -> tuple[dict[str, bytes], str]:
    """Name the file or folder that is opened, every eighth in a way that few programs expect."""
    end, content = made
    name = rng.choice(NAMES) if rng.random() < 1 / 8 else "input"
    if set(content) == {""}:
        return {f"{name}{end}": content[""]}, f"{name}{end}"
    return {f"{name}/{file}": data for file, data in content.items()}, f"{name}/{end}" if end else name
