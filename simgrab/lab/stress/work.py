"""The work on studies: cut into parts, shared among processes, each part written once and whole."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simgrab.errors import StressError
from simgrab.lab.stress import convergence, estimators, fidelities, score
from simgrab.lab.stress.parameters import Value
from simgrab.lab.stress.study import Study
from simgrab.runtime.cluster import ClusterPool, open_pool
from simgrab.runtime.processes import Pool

MOST_SLOW_TRIALS = 4
# One thread a process: more would only get in each other's way.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


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
    """Split a study into parts that its fidelity may draw together; parts with slow estimators are smaller."""
    fidelity = fidelities.find(study.depth)
    slow_until = max((study.trials_of(name) for name in study.fewer if name in study.estimators), default=0)
    result = []
    for index, point in enumerate(study.points):
        together = fidelity.together(fidelity.settle(study, point))
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
    fidelity = fidelities.find(study.depth)
    here = fidelity.settle(study, point)
    trials = range(part.first, part.last)
    records = fidelity.draw(here, study.seed, trials)
    tables = []
    for name in study.estimators:
        if study.kind == "convergence":
            columns = convergence.trace(records)
        elif study.trials_of(name) >= part.last:
            columns = score.score(estimators.run(name, records), records)
        elif (left := study.trials_of(name) - part.first) > 0:
            some = fidelity.draw(here, study.seed, trials[:left])
            columns = score.score(estimators.run(name, some), some)
        else:
            continue
        tables.append(_table(study, point, trials, name, columns))
    return pa.concat_tables(tables) if tables else schema(study).empty_table()


def schema(study: Study) -> pa.Schema:
    """Columns of a study's rows."""
    fields = [(s.axis, pa.string() if any(isinstance(v, str) for v in s.values) else pa.float64()) for s in study.axes]
    fields += [("trial", pa.int64()), ("estimator", pa.string()), ("status", pa.string()), ("reason", pa.string())]
    fields += [(name, pa.float64()) for name in fidelities.columns(study.kind)]
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


def made(study: Study, part: Part) -> bytes:
    """Make a part; gives the bytes of its table."""
    sink = io.BytesIO()
    pq.write_table(make(study, part), sink)
    return sink.getvalue()


def check_workers(workers: int) -> None:
    """Refuse a number of processes that cannot work."""
    if workers < 1:
        raise StressError(f"workers must be 1 or more, got {workers}")


def worker_pool(workers: int, cluster: str | None = None) -> Pool | ClusterPool:
    """Make the processes that work on studies: even for one worker a process of its own, so that numbers are the same.

    Parameters
    ----------
    workers : int
    cluster : str, optional
        Address of a Ray cluster, whose processes they are then.

    Raises
    ------
    StressError
        If there are none.
    ClusterError
        If there is no such cluster.
    """
    check_workers(workers)
    return open_pool(workers, cluster, environment=dict.fromkeys(_THREADS, "1"))
