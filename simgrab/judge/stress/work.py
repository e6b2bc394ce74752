"""The work on studies: cut into parts, shared among processes, each part written once and whole."""

from __future__ import annotations

import itertools
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simgrab.errors import StressError
from simgrab.files import drafted
from simgrab.judge.stress import convergence, depths, estimators, score
from simgrab.judge.stress.knobs import Value
from simgrab.judge.stress.study import Study
from simgrab.processes import die_with

MOST_SLOW_TRIALS = 4
# One thread a process: more would only get in each other's way.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

T = TypeVar("T")
Item = TypeVar("Item")


@dataclass(frozen=True)
class Part:
    """Replications ``first`` to ``last`` − 1 at one point of a study."""

    point: int
    first: int
    last: int

    @property
    def file(self) -> str:
        """Name of its table."""
        return f"{self.point:04d}-{self.first:08d}-{self.last:08d}.parquet"


def parts(study: Study) -> list[Part]:
    """Cut a study into parts that its depth may draw together. What slow estimators take part in is cut finer."""
    depth = depths.find(study.depth)
    slow_until = max((study.trials_of(name) for name in study.fewer if name in study.estimators), default=0)
    result = []
    for index, point in enumerate(study.points):
        together = depth.together(depth.settle(study, point))
        first = 0
        while first < study.replications:
            step = min(together, MOST_SLOW_TRIALS) if first < slow_until else together
            last = min(first + step, study.replications)
            result.append(Part(index, first, last))
            first = last
    return result


def make(study: Study, part: Part) -> pa.Table:
    """Draw, estimate and score the replications of a part: one row for each of them and each estimator."""
    point = study.points[part.point]
    depth = depths.find(study.depth)
    here = depth.settle(study, point)
    trials = range(part.first, part.last)
    records = depth.draw(here, study.seed, trials)
    tables = []
    for name in study.estimators:
        if study.kind == "convergence":
            columns = convergence.trace(records)
        elif study.trials_of(name) >= part.last:
            columns = score.score(estimators.run(name, records), records)
        elif (left := study.trials_of(name) - part.first) > 0:
            some = depth.draw(here, study.seed, trials[:left])
            columns = score.score(estimators.run(name, some), some)
        else:
            continue
        tables.append(_table(study, point, trials, name, columns))
    return pa.concat_tables(tables) if tables else schema(study).empty_table()


def schema(study: Study) -> pa.Schema:
    """Columns of a study's rows."""
    fields = [(s.axis, pa.string() if any(isinstance(v, str) for v in s.values) else pa.float64()) for s in study.axes]
    fields += [("trial", pa.int64()), ("estimator", pa.string()), ("status", pa.string()), ("reason", pa.string())]
    fields += [(name, pa.float64()) for name in depths.columns(study.kind)]
    return pa.schema(fields)


def _table(
    study: Study, point: tuple[Value, ...], trials: range, name: str, columns: dict[str, np.ndarray]
) -> pa.Table:
    m = len(columns["status"])
    whole = {s.axis: [str(v) if isinstance(v, str) else v] * m for s, v in zip(study.axes, point, strict=True)}
    data = {**whole, "trial": np.array(trials[:m]), "estimator": [name] * m, **columns}
    return pa.table(
        {
            field.name: pa.array(data[field.name], field.type, from_pandas=pa.types.is_floating(field.type))
            for field in schema(study)
        },
        schema=schema(study),
    )


def store(study: Study, folder: Path, part: Part) -> int:
    """Make a part and write it into a folder, whole or not at all; gives the number of its replications."""
    with drafted(folder / part.file) as draft:
        pq.write_table(make(study, part), draft)
    return part.last - part.first


@contextmanager
def crew(workers: int) -> Iterator[Callable[[Callable[[Item], T], Iterable[Item]], Iterator[T]]]:
    """Start processes; gives what does a piece of work for each item, in no set order.

    Even a single worker is a process of its own, so that its numbers are those of many.
    """
    if workers < 1:
        raise StressError(f"workers must be 1 or more, got {workers}")
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # spawned processes inherit it
    pool = ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=die_with, initargs=(os.getpid(),)
    )

    def share(work: Callable[[Item], T], items: Iterable[Item]) -> Iterator[T]:
        jobs = (pool.submit(work, item) for item in items)
        running = set(itertools.islice(jobs, 3 * workers))
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            running |= set(itertools.islice(jobs, len(done)))
            for future in done:
                yield future.result()

    try:
        yield share
    except BrokenProcessPool:
        raise StressError("a worker process died (out of memory?); go on with --resume and fewer --workers") from None
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
