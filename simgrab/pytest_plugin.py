"""For somebody else's tests: frames and truth of named scenes, and limits for a pipeline, by pytest.

It is loaded into every run of pytest where simgrab is installed, so it imports next to nothing until a fixture is used.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from simgrab.dataset.datasets import Dataset
    from simgrab.instrument.contract import Frame, Instrument
    from simgrab.judge.check.report import Report
    from simgrab.judge.check.suite import Limit, Suite
    from simgrab.model.calibration import Calibration
    from simgrab.model.truth import Row

MARKER = "simgrab_limit"
_LONGEST = 200  # characters of a folder's name


@dataclass(frozen=True)
class Record:
    """Frames of a scene as rendered, and what is known of them; the ``path`` of its dataset is the folder."""

    dataset: Dataset

    @property
    def frames(self) -> Iterable[Frame]:
        """Frames in order, read from disk on demand, again in each iteration."""
        from simgrab.instrument.source import open_source

        return open_source(self.dataset.path)

    @property
    def truth(self) -> tuple[Row, ...]:
        """A row of labels a frame."""
        return self.dataset.rows

    @property
    def calibration(self) -> Calibration:
        """What an instrument may know of the camera: never its tilt."""
        return self.dataset.calibration


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the places of cache and results."""
    group = parser.getgroup("simgrab")
    group.addoption(
        "--simgrab-cache", metavar="DIR", help="Where rendered scenes are kept.  [default: ~/.cache/simgrab]"
    )
    group.addoption("--simgrab-out", metavar="DIR", help="Folder of pages and other results, a folder a test.")


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line("markers", f"{MARKER}(metric, lower=, upper=): what simgrab_judge accepts of a pipeline")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Refuse limits without a metric to compare."""
    if item.get_closest_marker(MARKER) and "simgrab_judge" not in getattr(item, "fixturenames", ()):
        pytest.fail(f"{MARKER} needs the fixture simgrab_judge", pytrace=False)


@pytest.fixture(scope="session")
def simgrab_record(pytestconfig: pytest.Config) -> Callable[..., Record]:
    """Frames and truth of a scene, rendered once and kept between runs: ``simgrab_record("calm-day", frames=20)``.

    It takes a bundled scene or a scene file; optionally a mapping of the scenario's dotted keys to values; ``size``,
    the width and height of the images in px, which then show the same view; and values of keys without a dot.
    """
    from simgrab.judge.check import cache
    from simgrab.model import scenes

    where = _cache(pytestconfig)

    def record(
        scene: str | Path, changes: Mapping[str, Any] | None = None, /, size: tuple[int, int] | None = None, **keys: Any
    ) -> Record:
        scenario = scenes.load(scene, {**(changes or {}), **keys}, size=size)
        return Record(cache.rendered(scenario, where))

    return record


@pytest.fixture
def simgrab_judge(
    request: pytest.FixtureRequest,
) -> Iterator[Callable[[Instrument, Record], Mapping[str, float | None]]]:
    """Measure a record, evaluate, and hold the test's ``simgrab_limit`` marks against it.

    It takes an instrument and a record, fails where a limit is exceeded, and returns all metrics by name.
    """
    from simgrab.instrument.run.subject import checked
    from simgrab.judge.check.gate import judged
    from simgrab.judge.check.report import Report
    from simgrab.judge.check.trial import trial

    limits = _limits(request.node.iter_markers(MARKER))
    settle, done = _settling(request), []

    def judge(instrument: Instrument, record: Record) -> Mapping[str, float | None]:
        data, found = record.dataset.data, trial(record.dataset, checked(instrument, "simgrab_judge"))
        done.append(found)
        scenes = {data.scenario: judged(data.scenario, found, limits)}
        settle(Report(request.node.name, found.run.instrument, data.seed, scenes=scenes))
        return found.metrics

    yield judge
    if limits and not done:
        pytest.fail(f"{MARKER}: nothing was measured", pytrace=False)


@pytest.fixture
def simgrab_check(request: pytest.FixtureRequest) -> Callable[..., Report]:
    """Check a suite with its limits and baseline: ``simgrab_check("ci/port.toml")``.

    It takes a suite or its file, and an ``instrument`` if it is another than the suite's, as `simgrab check` does.
    """
    from simgrab.judge.check import gate

    settle = _settling(request)

    def check(suite: Suite | str | Path, instrument: Instrument | str | None = None) -> Report:
        report = gate.check(suite, gate.CheckOptions(instrument, cache=_cache(request.config)))
        settle(report)
        return report

    return check


def _cache(config: pytest.Config) -> Path:
    from simgrab.judge.check.cache import default

    where = config.getoption("--simgrab-cache")
    return Path(where) if where else default()


def _settling(request: pytest.FixtureRequest) -> Callable[[Report], None]:
    """Return what warns of a report's notes, writes it, and fails where it did, with causes and page."""
    numbers = itertools.count(1)

    def settle(report: Report) -> None:
        from simgrab.judge.check.page import page
        from simgrab.judge.check.report import PAGE, save

        for note in report.notes:
            warnings.warn(note, stacklevel=3)
        lines = [f"{v.scene} {v.what}: {v.message}".strip() for v in report.verdicts if v.status == "failed"]
        lines += [f"{name}: {scene.causes}" for name, scene in report.scenes.items() if scene.causes]
        if where := request.config.getoption("--simgrab-out"):
            name = re.sub(r"[^\w.-]+", "-", request.node.nodeid)[-_LONGEST:]
            out = Path(where) / f"{name}-{next(numbers)}"
            save(report, out, page(report))
            lines.append(f"page: {out / PAGE}")
        if not report.passed:
            pytest.fail("\n".join(lines), pytrace=False)

    return settle


def _limits(marks: Iterable[pytest.Mark]) -> dict[str, Limit]:
    """Limits of a test's marks by metric; the mark nearest to the test counts."""
    import msgspec

    from simgrab.judge.check.metrics import unknown
    from simgrab.judge.check.suite import Limit

    found: dict[str, Limit] = {}
    for mark in marks:
        if len(mark.args) != 1 or not isinstance(mark.args[0], str):
            pytest.fail(f"{MARKER} takes a metric's name, and lower= or upper=; got {mark.args}", pytrace=False)
        if problem := unknown(mark.args[0]):
            pytest.fail(f"{MARKER}: {problem}", pytrace=False)
        if "slack" in mark.kwargs:
            pytest.fail(f"{MARKER}: slack is for baselines, which suites have: see simgrab_check", pytrace=False)
        try:
            found.setdefault(mark.args[0], msgspec.convert(mark.kwargs, Limit))
        except msgspec.ValidationError as wrong:
            pytest.fail(f"{MARKER}({mark.args[0]!r}): {wrong}", pytrace=False)
    return found
