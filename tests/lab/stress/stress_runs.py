"""Studies run in this process, at the size of a test."""

from __future__ import annotations

import msgspec

from simgrab.lab.stress import catalogue, fidelities
from simgrab.lab.stress.study import Study
from simgrab.lab.stress.summary import Moments, Summary
from simgrab.lab.stress.work import make, parts


def small(study: str | Study, *points: tuple, **changes: object) -> Study:
    """A bundled study with other settings; of one axis only the values of the given points."""
    whole = catalogue.load(study) if isinstance(study, str) else study
    axes = whole.axes
    if points:
        axes = tuple(
            msgspec.structs.replace(s, values=tuple(dict.fromkeys(p[i] for p in points))) for i, s in enumerate(axes)
        )
    changed = msgspec.structs.replace(whole, axes=axes, **changes)
    kept = set(changed.points)
    return msgspec.structs.replace(
        changed,
        holds=changed.holds if changed.holds in kept else (),
        consistent=tuple(name for name in changed.consistent if name in changed.estimators),
        accept=tuple(a for a in changed.accept if a.at in kept and a.estimator in changed.estimators),
    )


def summed(study: Study) -> Summary:
    moments = Moments(study, fidelities.columns(study.kind))
    for part in parts(study):
        moments.add(make(study, part))
    return moments.summary()
