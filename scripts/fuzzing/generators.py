"""How inputs of each kind are made: from the structure of sound files by hypothesis, and from their bytes."""

from __future__ import annotations

import json
import os
import random
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hypothesis
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from scripts.fuzzing import bytewise, corpus, documents, media, nets, tables
from scripts.fuzzing.case import Case, Files
from simgrab.io.resources import SCENES
from simgrab.judge.check import suite
from simgrab.lab.stress import catalogue
from simgrab.model import layouts, scenes

# Names that a user's files may have; without suffix.
NAMES = (
    "a b", "a\nb", "\x1b[31mred", "\udcff\udcfe", "é", "年月日", "-x", "%05d", "a'b\"c", "x" * 200, "[ab]*", "#?&",
    "{0}", "\u202eb",
    "a\tb", "\u2028", "$HOME", "~",
)  # fmt: skip
PLAIN = "input"


@dataclass(frozen=True)
class Kind:
    """A kind of input.

    Attributes
    ----------
    structured : SearchStrategy of (suffix, dict of name to bytes)
        Files of one input. A single one without a name is the file that is opened; of several, their folder is.
    seeds : tuple of (suffix, dict of name to bytes)
        Sound ones for the byte mutator.
    damaged : tuple of str
        Names of the files that it may damage; empty for all.
    """

    structured: st.SearchStrategy[tuple[str, Mapping[str, bytes]]]
    seeds: tuple[tuple[str, Mapping[str, bytes]], ...]
    damaged: tuple[str, ...] = ()


def _alone(suffix: str) -> Callable[[bytes], tuple[str, Mapping[str, bytes]]]:
    return lambda data: (suffix, {"": data})


def _documents(suffix: str, found: list[Any]) -> Kind:
    """Kind of a TOML or JSON file."""
    as_text, strategy = (
        (documents.as_json, documents.jsons) if suffix == ".json" else (documents.as_toml, documents.toml)
    )
    seeds = tuple(_alone(suffix)(as_text(one).encode()) for one in found)
    return Kind(strategy(found).map(_alone(suffix)), seeds)


def _toml(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _scenario() -> Kind:
    whole = [scenes.load(name).to_dict() for name in ("quay-day", "free-swing", "work-cycles", "digits")]
    return _documents(".toml", [*(_toml(SCENES / f"{name}.toml") for name in scenes.names()), *whole, *whole])


def _manifest(made: Path) -> Kind:
    return _documents(".json", [_json(made / corpus.DATASET / "manifest.json"), _json(made / "swing.manifest.json")])


def _set() -> Kind:
    """Arguments of ``--set``, one after another with NUL bytes between them."""
    flat = dict(_dotted(scenes.load("quay-day").to_dict()))

    @st.composite
    def near(draw: st.DrawFn) -> str:
        key = draw(st.sampled_from(sorted(flat)))
        return f"{key}={documents.inline(documents.changed(draw, flat[key]))}"

    keys = (
        st.sampled_from(sorted(flat))
        | st.sampled_from(documents.KEYS)
        | st.sampled_from(sorted(flat)).map(lambda key: f"{key}.a")
    )
    texts = documents.values.map(documents.inline) | st.sampled_from(documents.TEXTS) | st.text(max_size=8)
    argument = near() | near() | st.tuples(keys, st.sampled_from(("=", "=", "=", "", "==", " = ")), texts).map("".join)
    joined = st.lists(argument, min_size=1, max_size=3).map(
        lambda parts: os.fsencode("\0".join(map(_encodable, parts)))
    )
    seeds = (
        "camera.beta_deg=5.0",
        "swing.alpha.sigma_deg=2\0frames=3",
        'camera.mount={model="fixed"}',
        "display.start=2022-01-26",
    )
    return Kind(joined.map(_alone(".txt")), tuple(_alone(".txt")(text.encode()) for text in seeds))


def _encodable(text: str) -> str:
    return re.sub("[\ud800-\udc7f\udd00-\udfff]", "?", text)  # what no bytes of an argument are decoded to


def _dotted(table: Mapping[str, Any], head: str = "") -> Iterator[tuple[str, Any]]:
    """Give each key of tables within tables, with its value."""
    for key, value in table.items():
        yield f"{head}{key}", value
        if isinstance(value, dict):
            yield from _dotted(value, f"{head}{key}.")


def _folder(sound: Mapping[str, bytes], changed: Mapping[str, st.SearchStrategy[bytes]]) -> Kind:
    """Kind of a folder, of which one file is changed."""
    one = st.sampled_from(sorted(changed)).flatmap(lambda name: st.tuples(st.just(name), changed[name] | st.none()))

    def files(change: tuple[str, bytes | None]) -> tuple[str, Mapping[str, bytes]]:
        rest = {name: data for name, data in sound.items() if name != change[0]}
        return "", rest if change[1] is None else rest | {change[0]: change[1]}

    return Kind(one.map(files), (("", sound),), tuple(sorted(changed)))


def _content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def _run(made: Path) -> Kind:
    kinds = []
    for name in (corpus.RUN, corpus.RUN_OF_VIDEO):
        sound = _content(made / name)
        sound.pop("angles.csv")
        kinds.append(
            _folder(
                sound,
                {
                    "run.json": documents.jsons([_json(made / name / "run.json")]),
                    "alarms.json": documents.jsons([_json(made / name / "alarms.json")]),
                    "camera.toml": documents.toml([_toml(made / name / "camera.toml")]),
                    "angles.parquet": tables.parquet(sound["angles.parquet"]),
                },
            )
        )
    return Kind(kinds[0].structured | kinds[1].structured, kinds[0].seeds + kinds[1].seeds, kinds[0].damaged)


def _truth(made: Path) -> Kind:
    sound = {f"x{end}": (made / f"swing{end}").read_bytes() for end in (".parquet", ".manifest.json")}
    kind = _folder(
        sound,
        {
            "x.parquet": tables.parquet(sound["x.parquet"]),
            "x.manifest.json": documents.jsons([_json(made / "swing.manifest.json")]),
        },
    )
    return Kind(kind.structured.map(lambda made: ("x.parquet", made[1])), (("x.parquet", sound),), kind.damaged)


def _dataset(made: Path) -> Kind:
    whole = _content(made / corpus.DATASET)
    sound = {
        name: data
        for name, data in whole.items()
        if name.startswith("images/") or name in ("labels.parquet", "manifest.json")
    }
    return _folder(
        sound,
        {
            "labels.parquet": tables.parquet(sound["labels.parquet"]),
            "manifest.json": documents.jsons([json.loads(sound["manifest.json"])]),
        },
    )


def _table(made: Path) -> Kind:
    csv, parquet = (made / corpus.RECORD).read_bytes(), (made / corpus.DATASET / "labels.parquet").read_bytes()
    structured = tables.csv(csv).map(_alone(".csv")) | tables.parquet(parquet).map(_alone(".parquet"))
    return Kind(structured, (_alone(".csv")(csv), _alone(".parquet")(parquet)))


def _picture(made: Path) -> Kind:
    """Folder of a sound picture and another."""
    sound = next(iter(sorted((made / corpus.DATASET).glob("images/*/*.jpg")))).read_bytes()
    some = examples(media.picture(), 24, 0)
    seeds = tuple(("", {f"1{suffix}": data}) for suffix, data in [(".jpg", sound), *some] if len(data) < 1 << 18)
    structured = media.picture().map(lambda one: ("", {"0.jpg": sound, f"1{one[0]}": one[1]}))
    return Kind(structured | media.picture().map(lambda one: ("", {f"1{one[0]}": one[1]})), seeds)


def _video(made: Path) -> Kind:
    some = [(suffix, data) for suffix, data in examples(media.video(), 24, 0) if 100 < len(data) < 1 << 18]
    seeds = tuple(_alone(suffix)(data) for suffix, data in [(".mp4", (made / corpus.VIDEO).read_bytes()), *some])
    return Kind(media.video().map(lambda one: _alone(one[0])(one[1])), seeds)


def _baseline() -> Kind:
    found = [_json(path) for path in sorted((suite.FOLDER / "baselines").glob("*/baseline.json"))]
    smoke = [one for one in found if one["suite"] == "smoke"]
    in_folder = documents.jsons(smoke).map(lambda data: ("", {"baseline.json": data}))
    return Kind(in_folder, tuple(("", {"baseline.json": documents.as_json(one).encode()}) for one in smoke))


KINDS: dict[str, Callable[[Path], Kind]] = {
    "scenario": lambda _: _scenario(),
    "manifest": _manifest,
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
    "detector": lambda _: Kind(nets.net().map(_alone(".onnx")), tuple(_alone(".onnx")(one) for one in nets.seeds())),
}


def cases(name: str, count: int, seed: int, made: Path) -> list[Case]:
    """Make inputs of a kind, half of them by each generator; the same for the same seed and versions of libraries.

    Parameters
    ----------
    name : str
        Of the kind.
    count : int
    seed : int
    made : Path
        Folder of `scripts.fuzzing.corpus.make`.
    """
    kind = KINDS[name](made)
    rng = random.Random(f"{seed}/{name}")
    structured = examples(kind.structured, count - count // 2, rng.getrandbits(64))
    result = [Case(name, i, "structure", _placed(files, rng)) for i, files in enumerate(structured)]
    while len(result) < count:
        suffix, sound = rng.choice(kind.seeds)
        file = rng.choice(kind.damaged or tuple(sorted(sound)))
        others = [files[file] for _, files in kind.seeds if file in files]
        damaged = {**sound, file: bytewise.mutate(sound[file], rng, others)}
        result.append(Case(name, len(result), "bytes", _placed((suffix, damaged), rng)))
    return result


def _placed(made: tuple[str, Mapping[str, bytes]], rng: random.Random) -> Files:
    """Name the file or folder that is opened, every eighth in a way that few programs expect."""
    end, content = made
    name = rng.choice(NAMES) if rng.random() < 1 / 8 else PLAIN
    if set(content) == {""}:
        return Files({f"{name}{end}": content[""]}, f"{name}{end}")
    return Files({f"{name}/{file}": data for file, data in content.items()}, f"{name}/{end}" if end else name)


def examples(strategy: st.SearchStrategy[Any], count: int, seed: int) -> list[Any]:
    """Draw values of a strategy, the same for the same seed."""
    rng = random.Random(seed)
    return [_example(strategy, rng.getrandbits(64)) for _ in range(count)]


def _example(strategy: st.SearchStrategy[Any], seed: int) -> Any:
    """Draw one value, in a run of its own: within a run hypothesis departs from what it drew before."""
    found: list[Any] = []

    @hypothesis.seed(seed)
    @settings(
        max_examples=2,  # of which the first is the simplest there is
        database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @hypothesis.given(strategy)
    def collect(value: Any) -> None:
        found.append(value)

    collect()
    return found[-1]
