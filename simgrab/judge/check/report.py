"""Result of a check, and its output formats: JSON, JUnit XML, a page, pictures."""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import SuiteError
from simgrab.io.destination import writing
from simgrab.io.files import write
from simgrab.io.parse import read_json
from simgrab.io.pictures import encode
from simgrab.judge.check.causes import Cause, causes
from simgrab.judge.check.suite import Limit
from simgrab.judge.check.trial import Metrics, Trial
from simgrab.judge.check.verdicts import Verdict, passes
from simgrab.judge.check.worst import WorstFrame, worst_frames

_Text = tuple[str, ...]  # between its numbers
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
RESULT, JUNIT, PAGE, PICTURES = "check.json", "junit.xml", "check.html", "golden"
_OF_CHECK = {"suite", "instrument", "verdicts", "pictures"}  # keys by which the result of a check is known


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of one scene.

    Attributes
    ----------
    verdicts : tuple of Verdict
    metrics : mapping of str to float or None
        All of them, judged or not.
    seconds : float
        Time, s, until its frames were rendered, measured and evaluated.
    pictures : mapping of str to ndarray of uint8, shape (height, width, 3)
        Pictures of golden frames that differ, by file name; RGB.
    notes : tuple of str
        Missing references, and limits that a constant answer meets.
    trial : Trial or None
        What was measured, for the page; None if the instrument failed.
    limits : mapping of str to Limit
        By which the metrics were judged.
    """

    verdicts: tuple[Verdict, ...]
    metrics: Metrics
    seconds: float
    pictures: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    trial: Trial | None = None
    limits: Mapping[str, Limit] = field(default_factory=dict)

    @property
    def causes(self) -> str:
        """What the errors of a scene that failed consist of, in sentences."""
        return " ".join(cause.text for cause in self.found)

    @cached_property
    def found(self) -> tuple[Cause, ...]:
        """The same, apart."""
        failed = [verdict for verdict in self.verdicts if verdict.status == "failed"]
        if self.trial is None or not failed:
            return ()
        compared = any(verdict.reference is not None for verdict in failed)
        of_centres = [v for v in self.verdicts if v.what.startswith("detection.centre") and v.reference is not None]
        steady = bool(of_centres) and all(verdict.status == "passed" for verdict in of_centres)
        of_boxes = "detection.centre."  # without a value where no box overlaps the grab's
        what = [v.what for v in failed if v.value is not None or v.what.startswith(of_boxes)]
        return tuple(causes(self.trial, what, compared=compared, steady=steady, meets=self.meets))

    def meets(self, metrics: Metrics) -> bool:
        """Whether all failed verdicts on these metrics, one at least, would pass with them."""
        failed = [one for one in self.verdicts if one.status == "failed" and one.what in metrics]
        return bool(failed) and all(passes(one, metrics[one.what], self.limits[one.what]) for one in failed)

    @cached_property
    def worst(self) -> list[WorstFrame]:
        """Frames with the largest errors, and those without an angle."""
        return [] if self.trial is None else list(worst_frames(self.trial, self.verdicts))


@dataclass(frozen=True, eq=False)
class Report:
    """Result of a check.

    Attributes
    ----------
    suite, instrument : str
    seed : int
    general : tuple of Verdict
        Verdicts of the suite as a whole.
    of_suite : tuple of str
        Notes on the suite as a whole: that there is no baseline, or what was recorded.
    scenes : mapping of str to Outcome
    """

    suite: str
    instrument: str
    seed: int
    general: tuple[Verdict, ...] = ()
    of_suite: tuple[str, ...] = ()
    scenes: Mapping[str, Outcome] = field(default_factory=dict)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Of the suite as a whole, then of each scene."""
        return self.general + tuple(v for scene in self.scenes.values() for v in scene.verdicts)

    @property
    def notes(self) -> tuple[str, ...]:
        """Of the suite as a whole, then of each scene."""
        return self.of_suite + tuple(note for scene in self.scenes.values() for note in scene.notes)

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return all(verdict.status != "failed" for verdict in self.verdicts)

    @property
    def common(self) -> Iterator[str]:
        """What most of the scenes that failed have as a cause, with the range of each number.

        A mistake that is one of several in every scene is left out beside one that a scene names alone.
        """
        named, beside = defaultdict[_Text, dict[str, list[str]]](dict), defaultdict[_Text, set[_Text]](set)
        failed = [name for name, scene in self.scenes.items() if any(v.status == "failed" for v in scene.verdicts)]
        for name in failed:
            for cause in self.scenes[name].found:
                texts = {tuple(_NUMBER.split(text)): _NUMBER.findall(text) for text in cause.mistakes}
                for between, numbers in texts.items():
                    named[between][name] = numbers
                    beside[between] |= set(texts) - {between} or {()}
        often = [between for between, scenes in named.items() if len(scenes) > max(1, len(failed) / 2)]
        for between in often:
            scenes = named[between]
            if () in beside[between] or not any(() in beside[other] for other in beside[between] & set(often)):
                ranges = [sorted(set(values), key=float) for values in zip(*scenes.values(), strict=True)]
                values = [" to ".join(dict.fromkeys((one[0], one[-1]))) for one in ranges]
                which = f"{len(scenes)} of {len(failed)} scenes that failed ({', '.join(scenes)})"
                text = "".join(itertools.chain(*zip(between, [*values, ""], strict=True)))
                yield f"In {which}: {text}."

    @property
    def pictures(self) -> dict[str, NDArray[np.uint8]]:
        """Pictures of all scenes, by file name."""
        return {name: picture for scene in self.scenes.values() for name, picture in scene.pictures.items()}


def as_json(report: Report) -> bytes:
    """Everything but the pictures, as JSON."""
    plain = {
        "suite": report.suite, "instrument": report.instrument, "seed": report.seed,
        "status": "passed" if report.passed else "failed",
        "verdicts": msgspec.to_builtins(report.verdicts), "notes": report.notes,
        "metrics": {name: scene.metrics for name, scene in report.scenes.items()},
        "common_causes": list(report.common),
        "causes": {name: scene.causes for name, scene in report.scenes.items() if scene.causes},
        "worst_frames": {name: [one.plain() for one in scene.worst] for name, scene in report.scenes.items()},
        "seconds": {name: round(scene.seconds, 3) for name, scene in report.scenes.items()},
        "pictures": [f"{PICTURES}/{name}" for name in report.pictures],
    }  # fmt: skip
    return msgspec.json.format(msgspec.json.encode(plain), indent=1) + b"\n"


def as_junit(report: Report) -> bytes:
    """One test case a verdict, as CI servers read them (the dialect of Ant's and pytest's JUnit XML).

    The cases of a scene share its time equally; other cases have 0 s.
    """
    statuses = [verdict.status for verdict in report.verdicts]
    totals = {
        "tests": str(len(statuses)), "failures": str(statuses.count("failed")), "errors": "0",
        "skipped": str(statuses.count("skipped")), "time": f"{sum(s.seconds for s in report.scenes.values()):.3f}",
    }  # fmt: skip
    root = ElementTree.Element("testsuites")
    suite = ElementTree.SubElement(root, "testsuite", {"name": f"simgrab.{report.suite}"} | totals)
    properties = ElementTree.SubElement(suite, "properties")
    ElementTree.SubElement(properties, "property", {"name": "report", "value": PAGE})
    for verdict in report.verdicts:
        place = ".".join(filter(None, ("simgrab", report.suite, verdict.scene)))
        scene = report.scenes.get(verdict.scene)
        seconds = scene.seconds / len(scene.verdicts) if scene and verdict in scene.verdicts else 0.0
        case = ElementTree.SubElement(
            suite, "testcase",
            {"classname": _printable(place), "name": _printable(verdict.what), "time": f"{seconds:.3f}"},
        )  # fmt: skip
        if verdict.status != "passed":
            tag = "failure" if verdict.status == "failed" else "skipped"
            why = scene.causes if scene and tag == "failure" else ""
            message = ". ".join(filter(None, (verdict.message, why)))
            found = ElementTree.SubElement(case, tag, {"message": _printable(message)})
            found.text = _printable(f"see {PAGE}#{anchor(verdict.scene)}")
    ElementTree.SubElement(suite, "system-out").text = "\n".join(map(_printable, report.notes))
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def anchor(scene: str) -> str:
    """Name of a scene's part of the page, where its name may hold blanks."""
    return scene.replace(" ", "_")


def _printable(text: str) -> str:
    """Leave out characters that XML 1.0 does not allow: an instrument may raise any text."""
    return "".join(c if c.isprintable() else " " for c in text)


def save(report: Report, out: Path, page: str) -> None:
    """Write ``check.json``, ``check.html``, ``junit.xml`` and ``golden/``, each file whole or not at all.

    ``page`` is what `simgrab.judge.check.page.page` makes of the report. Raises `SuiteError` if nothing can be written.
    """
    clear(out)
    with writing(out, SuiteError):
        for name, picture in report.pictures.items():
            write(out / PICTURES / name, encode(picture[..., ::-1], "png"))
        write(out / PAGE, page)
        write(out / JUNIT, as_junit(report))
        write(out / RESULT, as_json(report))


def clear(out: Path) -> None:
    """Delete what an earlier check wrote, so that it is not taken for the result of one that ends early.

    Files of other programs remain: nothing is deleted without the earlier check's ``check.json``. Raises `SuiteError`
    if something cannot be deleted.
    """
    with writing(out, SuiteError):
        for name in _earlier(out / RESULT):
            (out / name).unlink(missing_ok=True)


def _earlier(result: Path) -> list[str]:
    """Files that an earlier check left, its result last; none if this is not the result of a check."""
    try:
        found = read_json(result, SuiteError)
        if not found.keys() >= _OF_CHECK:
            return []
        pictures = [name for name in found["pictures"] if Path(name).parent == Path(PICTURES)]
    except (SuiteError, AttributeError, TypeError):
        return []
    return [*pictures, PAGE, JUNIT, RESULT]
