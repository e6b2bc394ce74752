"""Run studies into a folder: in parallel, taken up again after any interruption, in bounded memory."""

from __future__ import annotations

import contextlib
import functools
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow.csv
import pyarrow.parquet as pq

from simgrab._version import __version__
from simgrab.errors import StressError
from simgrab.io import parquet
from simgrab.io.destination import check_folder, locked_folder, writing
from simgrab.io.files import drafted, write
from simgrab.io.parse import read_json
from simgrab.lab.stress import fidelities
from simgrab.lab.stress.study import Study
from simgrab.lab.stress.summary import Finding, Moments, Summary, Verdict, judge
from simgrab.lab.stress.work import Part, check_workers, made, parts, schema, worker_pool

_SAME = {
    "digest": "its settings differ",
    "simgrab": "made by another version",
    "made_with": "made by another renderer, or detected with other weights",
}

Progress = Callable[[int, int], None]
STUDY, PARTIAL, TRIALS, SUMMARY, REPORT = "study.json", ".partial", "trials.parquet", "summary.csv", "report.html"


def run(
    studies: Sequence[Study],
    out: str | Path,
    *,
    workers: int = 1,
    cluster: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> list[Finding]:
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
    check_workers(workers)
    folder = Path(out)
    check_folder(folder, StressError)
    with locked_folder(folder, StressError):
        return _run(studies, folder, workers, cluster, resume=resume, progress=progress)


def _run(
    studies: Sequence[Study],
    folder: Path,
    workers: int,
    cluster: str | None,
    *,
    resume: bool,
    progress: Progress | None,
) -> list[Finding]:
    from simgrab.lab.stress import page

    missing: list[tuple[Study, Path, Part]] = []
    with writing(folder, StressError):
        for study in studies:
            missing += _open(study, folder / study.name, resume=resume)
    total = sum(len(study.points) * study.replications for study in studies)
    done = total - sum(part.last - part.first for _, _, part in missing)
    if progress:
        progress(done, total)
    with contextlib.ExitStack() as pools:
        here = makers = worker_pool(workers)
        pools.enter_context(here)
        if cluster is not None:
            makers = worker_pool(workers, cluster)
            pools.enter_context(makers)
        for file, data, count in makers.map(_made, missing, name=_named):
            with writing(folder, StressError):
                write(file, data)
            done += count
            if progress:
                progress(done, total)
        unfinished = [study for study in studies if (folder / study.name / PARTIAL).exists()]
        for _ in here.map(functools.partial(_finish, folder), unfinished, name=lambda study: study.name):
            pass
        findings = [read(folder / study.name, study) for study in studies]
        page.write(findings, folder / REPORT, functools.partial(here.map, name=_figured))
    return findings


def _named(job: tuple[Study, Path, Part]) -> str:
    study, _, part = job
    return f"{study.name}, point {part.point + 1}, replications {part.first} to {part.last - 1}"


def _figured(finding: Finding) -> str:
    return f"figures of {finding.summary.study.name}"


def _made(job: tuple[Study, Path, Part]) -> tuple[Path, bytes, int]:
    """Make a part; gives its file, what it is to hold, and the number of its replications."""
    study, path, part = job
    return path / PARTIAL / part.file, made(study, part), part.last - part.first


def _identity(study: Study) -> dict[str, Any]:
    made_with = fidelities.find(study.depth).made_with()
    return {
        "simgrab": __version__, "made_with": made_with, "digest": study.digest, "study": msgspec.to_builtins(study),
    }  # fmt: skip


def _open(study: Study, path: Path, *, resume: bool) -> list[tuple[Study, Path, Part]]:
    """Claim a study's folder; gives the parts that remain to be made."""
    identity = path / STUDY
    if identity.exists():
        known = read_json(identity, StressError)
        if not isinstance(known, dict):
            raise StressError(f"{identity} is not a study that simgrab wrote; choose another --out")
        if not resume:
            advice = "continue with --resume, or choose" if (path / PARTIAL).exists() else "choose"
            raise StressError(f"{path} holds a study already; {advice} another --out")
        mine = _identity(study)
        changed = [why for key, why in _SAME.items() if known.get(key, "") != mine[key]]
        if changed:
            what = changed[0]
            raise StressError(f"{path} holds another study ({what}); --resume needs the same, or choose another --out")
        if (path / SUMMARY).exists():  # it comes last
            shutil.rmtree(path / PARTIAL, ignore_errors=True)
            return []
    elif path.exists() and any(path.iterdir()):
        raise StressError(f"{path} contains something other than a study; choose another --out")
    (path / PARTIAL).mkdir(parents=True, exist_ok=True)
    write(identity, json.dumps(_identity(study), indent=1, ensure_ascii=False))
    return [(study, path, part) for part in parts(study) if not (path / PARTIAL / part.file).exists()]


def _finish(out: Path, study: Study) -> None:
    """Join the parts of a study, one at a time, and drop them."""
    path = out / study.name
    with drafted(path / TRIALS) as draft, draft.open("wb") as file, pq.ParquetWriter(file, schema(study)) as writer:
        for part in parts(study):
            writer.write_table(parquet.read_table(path / PARTIAL / part.file, StressError))
    with drafted(path / SUMMARY) as draft, draft.open("wb") as file:
        pyarrow.csv.write_csv(_summed(study, path).table(), file)
    shutil.rmtree(path / PARTIAL)


def _summed(study: Study, path: Path) -> Summary:
    moments = Moments(study, fidelities.columns(study.kind))
    for table in parquet.groups(path / TRIALS):
        moments.add(table)
    return moments.summary()


def read(path: Path, study: Study) -> Finding:
    """Read a finished study."""
    summary = _summed(study, path)
    return Finding(path, summary, tuple(judge(summary)))


def failures(findings: Iterable[Finding]) -> list[Verdict]:
    """Limits that are not met."""
    return [verdict for finding in findings for verdict in finding.verdicts if not verdict.passed]


def outcome(findings: Sequence[Finding]) -> str:
    """Say how many limits are met."""
    count = sum(len(finding.verdicts) for finding in findings)
    return f"{count - len(failures(findings))} of {count} limits are met" if count else "no limits were set"
