"""Run studies into a folder: in parallel, taken up again after any interruption, in bounded memory.

The work is cut into parts, shared among processes; each part is written once and whole.
"""

from __future__ import annotations

import contextlib
import functools
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from simgrab._version import __version__
from simgrab.errors import StressError
from simgrab.instrument.estimate import ESTIMATORS
from simgrab.io import parquet
from simgrab.io.destination import check_folder, locked_folder
from simgrab.io.files import drafted
from simgrab.io.journal import Journal
from simgrab.io.stores import Store
from simgrab.lab.stress import convergence, estimators, score
from simgrab.lab.stress.catalogue import depth_of, load
from simgrab.lab.stress.catalogue import read as read_study
from simgrab.lab.stress.records import Records
from simgrab.lab.stress.study import Study, resized
from simgrab.lab.stress.summary import LimitVerdict, StudyResult, StudySummary, judge
from simgrab.runtime.cluster import open_pool
from simgrab.runtime.processes import Executor

MOST_SLOW_TRIALS = 4
# One thread a process: more would only get in each other's way.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Progress = Callable[[int, int], None]
Own = Mapping[str, estimators.Estimating]
STUDY, PARTIAL, TRIALS, SUMMARY, REPORT = "study.json", ".partial", "trials.parquet", "summary.csv", "report.html"


@dataclass(frozen=True)
class ReplicationBatch:
    """Replications ``first`` to ``last`` − 1 at one point of a study."""

    point: int
    first: int
    last: int

    @property
    def file(self) -> str:
        """Name of its table."""
        return f"{self.point:04d}-{self.first:08d}-{self.last:08d}.parquet"


def parts(study: Study) -> list[ReplicationBatch]:
    """Split a study into parts that may be drawn together; parts with slow estimators are smaller."""
    depth = depth_of(study.depth)
    slow_until = max((study.trials_of(name) for name in study.fewer if name in study.estimators), default=0)
    result = []
    for index, point in enumerate(study.points):
        together = depth.together(depth.prepare(study, point))
        first = 0
        while first < study.replications:
            step = min(together, MOST_SLOW_TRIALS) if first < slow_until else together
            last = min(first + step, study.replications)
            result.append(ReplicationBatch(index, first, last))
            first = last
    return result


def make(study: Study, part: ReplicationBatch, own: Own | None = None) -> pa.Table:
    """Draw, estimate and score the replications of a part: one row for each of them and each estimator."""
    point, depth = study.points[part.point], depth_of(study.depth)
    here = depth.prepare(study, point)
    records = depth.draw(here, study.seed, range(part.first, part.last))
    fields = schema(study)
    place = {s.axis: str(v) if isinstance(v, str) else v for s, v in zip(study.axes, point, strict=True)}
    tables = [fields.empty_table()]
    for name in study.estimators:
        last = min(part.last, study.trials_of(name) if study.kind == "estimators" else part.last)
        if last <= part.first:
            continue
        trials = range(part.first, last)
        some = records if last == part.last else depth.draw(here, study.seed, trials)
        whole = {key: [value] * len(trials) for key, value in (place | {"estimator": name}).items()}
        data = {**whole, "trial": np.array(trials), **scored(study, name, some, own)}
        arrays = [pa.array(data[f.name], f.type, from_pandas=pa.types.is_floating(f.type)) for f in fields]
        tables.append(pa.table(arrays, schema=fields))
    return pa.concat_tables(tables)


def scored(study: Study, estimator: str, records: Records, own: Own | None = None) -> dict[str, np.ndarray]:
    """Estimate from M records and judge: `Study.columns`, ``status`` and ``reason``, shape (M,) each."""
    if study.kind == "convergence":
        return convergence.trace(records)
    return score.score(estimators.run(estimator, records, own), records)


def schema(study: Study) -> pa.Schema:
    """Columns of a study's rows."""
    fields = [(s.axis, pa.string() if any(isinstance(v, str) for v in s.values) else pa.float64()) for s in study.axes]
    fields += [("trial", pa.int64()), ("estimator", pa.string()), ("status", pa.string()), ("reason", pa.string())]
    return pa.schema(fields + [(name, pa.float64()) for name in study.columns])


def made(job: tuple[Study, ReplicationBatch]) -> tuple[str, ReplicationBatch, bytes]:
    """Make a part; gives the study's name, the part and the bytes of its table."""
    study, part = job
    sink = io.BytesIO()
    pq.write_table(make(study, part), sink)
    return study.name, part, sink.getvalue()


def worker_pool(workers: int, cluster: str | None = None) -> Executor:
    """Make the processes that work on studies, here or of a Ray cluster's address; raises `StressError` without any.

    Even one worker is a process of its own, so that numbers are the same.
    """
    if workers < 1:
        raise StressError(f"workers must be 1 or more, got {workers}")
    return open_pool(workers, cluster, environment=dict.fromkeys(_THREADS, "1"))


def stress(
    study: str | Path | Mapping[str, object],
    own: Own | None = None,
    *,
    frames: int | None = None,
    replications: int | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> pa.Table:
    """Run a study in this process, with estimators of your own beside those that it names.

    Parameters
    ----------
    study : str, path or mapping
        Name of a bundled study, a TOML file, or the content of one.
    own : mapping of str to estimator, optional
        By the names that the table shall have. An estimator is any object with a method
        ``estimate(pixels, calibration, *, rope_length, time)`` that returns an `Estimate`; see docs/stressing.md.
    frames, replications, seed : int, optional
        In place of the study's own.
    progress : callable, optional
        Called with (replications done, replications in all), each at one point.

    Returns
    -------
    pyarrow.Table
        A row for each point of the study's axes, estimator and quantity, with the columns of ``summary.csv``: the axes,
        ``estimator``, ``quantity``, ``count``, ``mean``, ``rms`` and the Monte Carlo errors of both.

    Raises
    ------
    StressError
        If the study or an estimator is not valid, an estimator fails, or ``frames`` is given for an axis ``n``.

    Examples
    --------
    >>> import simgrab
    >>> table = simgrab.stress("outliers", frames=100, replications=2)
    >>> table.column_names[:4]
    ['outliers', 'estimator', 'quantity', 'count']
    """
    chosen = read_study(study) if isinstance(study, Mapping) else load(study)
    for name, estimator in (own or {}).items():
        if name in ESTIMATORS:
            raise StressError(f"own: {name!r} means the bundled {ESTIMATORS.full(name)}; choose another name")
        estimators.checked(name, estimator)
        if chosen.depth == "rendered":
            raise StressError(f"own: at the depth 'rendered', name {name!r} in estimators, as package.module:Class")
    chosen = resized(chosen, frames, replications, seed)
    chosen = msgspec.structs.replace(chosen, estimators=(*chosen.estimators, *(own or {})))
    summary = StudySummary(chosen)
    done, total = 0, len(chosen.points) * chosen.replications
    for part in parts(chosen):
        summary.add(make(chosen, part, own))
        done += part.last - part.first
        if progress:
            progress(done, total)
    return summary.table()


def run(
    studies: Sequence[Study],
    out: str | Path,
    *,
    workers: int = 1,
    cluster: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> list[StudyResult]:
    """Run studies and write the report.

    Each study gets a folder of its name in ``out`` with ``trials.parquet`` (one row for each point, replication and
    estimator), ``summary.csv`` and ``study.json``; ``report.html`` shows all of them. The tables are the same for any
    number of workers, and however often the run was interrupted.

    Parameters
    ----------
    studies : sequence of Study
    out : path
    workers : int
        Processes.
    cluster : str, optional
        Address of a Ray cluster that draws and estimates in their place.
    resume : bool
        Go on with what an interrupted run of the same studies left there.
    progress : callable, optional
        Called with (replications done, replications in all), each at one point.

    Raises
    ------
    StressError
        If a folder cannot be used, or an estimator fails.
    WorkerError
        If processes die of a part again and again.
    ClusterError
        If there is no such cluster, or its machines have other versions.
    """
    from simgrab.lab.stress import page

    folder = Path(out)
    check_folder(folder, StressError)
    with contextlib.ExitStack() as stack:
        stack.enter_context(locked_folder(folder, StressError))
        here = makers = worker_pool(workers)
        stack.enter_context(here)
        journals = {study.name: journal(study, folder) for study in studies}
        identities = {study.name: _identity(study) for study in studies}
        unfinished = [one for one in studies if journals[one.name].check(identities[one.name], resume=resume)]
        total = sum(len(study.points) * study.replications for study in studies)
        missing: list[tuple[Study, ReplicationBatch]] = []
        for study in unfinished:
            stack.enter_context(journals[study.name].opened(identities[study.name]))
            there = journals[study.name].units()
            missing += [(study, part) for part in parts(study) if part.file not in there]
        done = total - sum(part.last - part.first for _, part in missing)
        if progress:
            progress(done, total)
        if cluster is not None:
            makers = worker_pool(workers, cluster)
            stack.enter_context(makers)
        for name, part, data in makers.map(made, missing, name=_named):
            journals[name].add(part.file, data)
            done += part.last - part.first
            if progress:
                progress(done, total)
        for name in here.map(functools.partial(_finish, folder), unfinished, name=lambda study: study.name):
            journals[name].finish(identities[name])
        findings = [read(folder / study.name, study) for study in studies]
        figured = functools.partial(here.map, name=lambda finding: f"figures of {finding.summary.study.name}")
        page.write(findings, folder / REPORT, figured)
    return findings


def journal(study: Study, out: Path) -> Journal:
    """Keep the journal of a study, whose units are parts, in a folder of its name."""
    return Journal(Store(str(out / study.name), drafts=PARTIAL, refuse=StressError), whole=STUDY, kind="study")


def _named(job: tuple[Study, ReplicationBatch]) -> str:
    study, part = job
    return f"{study.name}, point {part.point + 1}, replications {part.first} to {part.last - 1}"


def _identity(study: Study) -> dict[str, Any]:
    return {
        "simgrab": __version__, "made_with": depth_of(study.depth).made_with(), "digest": study.digest,
        "sources": estimators.sources(study.estimators), "study": msgspec.to_builtins(study),
    }  # fmt: skip


def _finish(out: Path, study: Study) -> str:
    """Join the parts of a study, one at a time; gives its name."""
    path, found = out / study.name, journal(study, out)
    with drafted(path / TRIALS) as draft, draft.open("wb") as file, pq.ParquetWriter(file, schema(study)) as writer:
        for part in parts(study):
            writer.write_table(parquet.read_table(path / found.record(part.file), StressError))
    with drafted(path / SUMMARY) as draft, draft.open("wb") as file:
        pyarrow.csv.write_csv(_summed(study, path).table(), file)
    return study.name


def _summed(study: Study, path: Path) -> StudySummary:
    summary = StudySummary(study)
    for table in parquet.groups(path / TRIALS):
        summary.add(table)
    return summary


def read(path: Path, study: Study) -> StudyResult:
    """Read a finished study."""
    summary = _summed(study, path)
    return StudyResult(summary, tuple(judge(summary)))


def failures(findings: Iterable[StudyResult]) -> list[LimitVerdict]:
    """Limits that are not met."""
    return [verdict for finding in findings for verdict in finding.verdicts if not verdict.passed]


def outcome(findings: Sequence[StudyResult]) -> str:
    """Say how many limits are met."""
    count = sum(len(finding.verdicts) for finding in findings)
    return f"{count - len(failures(findings))} of {count} limits are met" if count else "no limits were set"
