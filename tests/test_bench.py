"""Results of benchmarks: kept whole, compared, and taken of the same scene."""

import re

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from scripts import bench, bench_results
from scripts.bench import in_turns
from scripts.bench_results import Quantity, Results, compare, ratio
from scripts.renderers import compared
from simgrab.errors import SimgrabError

FRAME = Quantity("frame", "ms", (130.0, 134.0, 150.0, 141.0))
RESULTS = Results(
    verb="render",
    options={"pairs": 4},
    commit="0" * 40,
    date="2026-11-24T02:00:00+00:00",
    machine={"cpu": "EPYC", "cores": "2"},
    versions={"mujoco": "4.0.0", "numpy": "2.4.6"},
    quantities=(FRAME, Quantity("memory", "MB", (300.0,)), Quantity("growth", "MB", (0.0, -1.0))),
)


def changed(**fields):
    return msgspec.structs.replace(RESULTS, **fields)


def scaled(quantity, factor):
    return msgspec.structs.replace(quantity, samples=tuple(factor * s for s in quantity.samples))


def test_a_file_holds_every_sample_also_of_arrays(tmp_path):
    seconds = np.array([0.25, 0.5])
    made = Quantity.ms("x", seconds), Quantity.of("y", "×", *seconds), Quantity.of("z", "MB", np.float64(3.0))
    assert [q.samples for q in made] == [(250, 500), (0.25, 0.5), (3,)]
    for results in (RESULTS, changed(quantities=made)):
        results.save(tmp_path / "a.json")
        assert bench_results.load(tmp_path / "a.json") == results


def test_a_verb_keeps_what_it_measured_and_on_what(tmp_path, monkeypatch):
    monkeypatch.setitem(bench.VERBS, "world", (lambda: iter([FRAME]), []))
    done = CliRunner().invoke(bench.command("world"), ["--json", str(tmp_path / "new" / "a.json")])
    results = bench_results.load(tmp_path / "new" / "a.json")
    assert (results.verb, results.options, results.quantities) == ("world", {}, (FRAME,))
    assert {"cpu", "cores", "memory", "opengl", "system"} <= {key for key, value in results.machine.items() if value}
    assert {"python", "simgrab", "mujoco", "numpy", "opencv-python-headless"} <= results.versions.keys()
    assert re.fullmatch(r"[0-9a-f]{40}\+?|unknown", results.commit)
    assert "137.5 ms (median of 4" in done.output


def test_the_ratio_is_that_of_medians_and_lies_in_its_interval():
    middle, low, high = ratio(FRAME, scaled(FRAME, 2.0))
    assert middle == pytest.approx(2.0)
    assert low < 2.0 < high
    backwards = ratio(scaled(FRAME, 2.0), FRAME)
    assert backwards[0] == pytest.approx(0.5)


def test_the_interval_holds_the_true_ratio_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        one, other = (Quantity("x", "ms", tuple(s * np.exp(0.2 * rng.normal(size=25)))) for s in (100.0, 80.0))
        _, low, high = ratio(one, other)
        held += low <= 0.8 <= high
    assert 180 <= held <= 199  # 95 % of 200, and a percentile bootstrap of a median holds it a little too often


def test_the_comparison_states_ratio_spread_and_what_has_none():
    other = changed(quantities=(*(scaled(q, 0.5) for q in RESULTS.quantities), Quantity("peak", "MB", (1.0,))))
    lines = list(compare(RESULTS, other))
    (frame,), (memory,), (growth,) = ([x for x in lines if x.startswith(q.name)] for q in RESULTS.quantities)
    assert re.search(r"137\.5 +68\.75  0\.500 \(0\.\d{3}–0\.\d{3}; n = 4 and 4\)  ms", frame)
    assert "0.500 (no spread: one sample)" in memory
    assert "no ratio" in growth
    assert lines[-1] == "only in B: peak"
    assert not any("different" in line for line in lines)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"machine": {"cpu": "Xeon", "cores": "2"}}, "different machine: cpu: EPYC in A, Xeon in B"),
        ({"versions": {"mujoco": "4.0.0"}}, "different versions: numpy: 2.4.6 in A, absent in B"),
        ({"options": {"pairs": 9}}, "different options: pairs: 4 in A, 9 in B"),
    ],
)  # fmt: skip
def test_what_differs_between_the_runs_is_named(fields, expected):
    assert [line for line in compare(RESULTS, changed(**fields)) if "different" in line] == [expected]


@pytest.mark.parametrize(
    ("fields", "why"), [({"unit": "s"}, "'frame' is in ms in A and in s in B"), ({"name": "x"}, "nothing to compare")]
)
def test_what_has_another_unit_or_name_is_not_compared(fields, why):
    other = changed(quantities=(msgspec.structs.replace(FRAME, **fields),))
    with pytest.raises(SimgrabError, match=why):
        list(compare(RESULTS, other))


def test_acts_take_turns_and_warm_up_untimed():
    calls = []
    acts = {name: lambda item, name=name: calls.append((name, item)) for name in ("a", "b")}
    took = in_turns(acts, range(5), 2)
    assert calls == [(name, item) for item in range(5) for name in acts]
    assert {name: len(seconds) for name, seconds in took.items()} == {"a": 3, "b": 3}


@pytest.mark.slow
def test_renderers_take_turns_over_worlds_that_change():
    found = list(compared("training-large", (480, 270), 8, pyrender=False, blender=None, traced=1))
    assert {quantity.name.partition(":")[0] for quantity in found} == {"simgrab", "mujoco.Renderer"}
    assert {len(quantity.samples) for quantity in found} == {8}
    assert all(quantity.median > 0 for quantity in found)
