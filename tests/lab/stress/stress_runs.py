"""Studies run in this process, at the size of a test."""

from __future__ import annotations

import functools

import msgspec
import pytest

from simgrab.errors import StressError
from simgrab.lab.stress import catalogue
from simgrab.lab.stress.laboratory import make, parts
from simgrab.lab.stress.study import Study
from simgrab.lab.stress.summary import StudySummary

bundled = functools.cache(catalogue.load)


def small(study: str | Study, *points: tuple, **changes: object) -> Study:
    """A bundled study with other settings; of one axis only the values of the given points."""
    whole = bundled(study) if isinstance(study, str) else study
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


def summed(study: Study) -> StudySummary:
    summary = StudySummary(study)
    for part in parts(study):
        summary.add(make(study, part))
    return summary


def refused(read, words):
    """A study that cannot be is refused in one line that has these words."""
    with pytest.raises(StressError) as refusal:
        read()
    assert "\n" not in str(refusal.value)
    assert not [word for word in words if word not in str(refusal.value)]
