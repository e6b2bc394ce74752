"""What opens each kind of input, as the command line does, and then goes a step further where that is cheap."""

from __future__ import annotations

import functools
import itertools
import json
import os
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from scripts.fuzzing import corpus
from simgrab.dataset import datasets
from simgrab.instrument.detect import detector
from simgrab.instrument.detect import pictures as detections
from simgrab.instrument.estimate import ESTIMATORS, follow
from simgrab.instrument.estimate import measure as judge
from simgrab.instrument.estimate.table import show
from simgrab.instrument.run import runs
from simgrab.instrument.source import Source, fitting, open_source
from simgrab.io.strict import convert
from simgrab.judge.check import baseline, suite
from simgrab.judge.evaluate import truths
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.judge.evaluate.table import tables
from simgrab.lab.stress import catalogue, geometric
from simgrab.lab.stress.study import quickened
from simgrab.model import calibration, layouts, scenes
from simgrab.model.calibration import Calibration
from simgrab.model.records import frame_files
from simgrab.model.records.observations import Detection
from simgrab.model.scenario import Dynamic, Scenario, variant
from simgrab.model.scenario.surroundings import Clutter, Plain
from simgrab.world.projection import project
from simgrab.world.scenery.plan import Plan, draw_up
from simgrab.world.trajectory.trajectory import Trajectory

Opener = Callable[[Path, Path], None]
DECODED = 50  # frames of a video
MOST_SETTLE_S, MOST_DRAWN = 60.0, 3


def scene(target: Path, _corpus: Path) -> None:
    """Load a scenario, draw frames of its first clip, and compute what labels know before anything is rendered."""
    _draw(scenes.load(target))


def assignments(target: Path, _corpus: Path) -> None:
    """Change a bundled scene by ``--set`` and its arguments, which NUL bytes separate in the file."""
    arguments = os.fsdecode(target.read_bytes()).split("\0")
    _draw(scenes.load("quay-day", scenes.parse_changes(arguments)))


def _draw(scenario: Scenario) -> None:
    scenario.digest()
    assert convert(json.loads(json.dumps(scenario.to_dict())), Scenario) == scenario
    scenario.to_toml()
    one = variant(scenario, 0).scenario
    one = msgspec.structs.replace(one, place=Plain(), clutter=Clutter())  # whose meshes take seconds, and read few keys
    if isinstance(one.swing, Dynamic):
        settle = min(one.swing.settle_s, MOST_SETTLE_S)
        one = msgspec.structs.replace(one, swing=msgspec.structs.replace(one.swing, settle_s=settle))
    plan = _plan(msgspec.json.encode((one.grab, one.jib)), one)
    story = Trajectory(one, plan=plan)
    for frame in range(min(one.clip.clip_frames or one.frames, one.frames, MOST_DRAWN)):
        projection = project(one, plan, story.at(frame))
        projection.meets(one.camera.width_px, one.camera.height_px)


_PLANS: dict[bytes, Plan] = {}


def _plan(key: bytes, scenario: Scenario) -> Plan:
    """Make the meshes of grab and jib, or take those made before."""
    if key not in _PLANS:
        if len(_PLANS) > 4:
            _PLANS.clear()
        _PLANS[key] = draw_up(scenario)
    return _PLANS[key]


def camera(target: Path, _corpus: Path) -> None:
    """Load a camera file, and project with it."""
    found = calibration.load(target)
    found.to_toml()
    k = found.intrinsics
    with np.errstate(all="ignore"):
        k.undistort(np.array([[0.0, 0.0], [k.width_px, k.height_px]]))
        k.project(np.array([[0.0, 0.0, 1.0], [0.1, -0.1, 2.0]]))
    if found.digit_layout is not None:
        _written(found.digit_layout)


def layout(target: Path, _corpus: Path) -> None:
    """Load a digit layout, and write and fit it."""
    _written(layouts.read(target))


def _written(found: layouts.Layout) -> None:
    assert found.lengths(found.text(20.15, 21.0)) is not None
    assert len(found.cells) == 8
    assert found.points is not None
    found.scaled(2 * found.width_px, 2 * found.height_px)


def tilt(target: Path, corpus_folder: Path) -> None:
    """Load a tilt, and follow a few frames with it."""
    known = follow.load(target)
    pixels = np.array([[240.0, 135.0], [np.nan, np.nan], [0.0, 270.0]])
    with np.errstate(all="ignore"):
        follow.follow(known, pixels, _camera(corpus_folder), rope_length=np.array([8.0, 15.0, 30.0]))
    known.to_toml()


@functools.cache
def _camera(corpus_folder: Path) -> Calibration:
    return calibration.load(corpus_folder / corpus.CAMERA)


def suites(target: Path, _corpus: Path) -> None:
    """Load a suite."""
    found = suite.load(target)
    assert found.scenes
    baseline.ends(found)


def baselines(target: Path, _corpus: Path) -> None:
    """Load a baseline, and compare it with a suite."""
    found = baseline.load(target)
    smoke = suite.load("smoke")
    if found is None or baseline.stale(found, smoke, found.instrument):
        return
    for name, recorded in found.scenes.items():
        if name in smoke.scenes:
            for metric, limit in smoke.limits_of(name).items():
                baseline.reference(recorded, metric, limit, recorded.labels[0] if recorded.labels else "", 10)
                baseline.reference(recorded, metric, limit, "", 10)


def study(target: Path, _corpus: Path) -> None:
    """Load a study, and draw one short record of it."""
    found = quickened(catalogue.load(target))
    given = {key: value for key, value in found.given.items() if key != "n"}
    short = msgspec.structs.replace(found, n=20, given=given)
    if short.kind == "estimators" and short.depth == "geometric" and all(s.axis != "n" for s in short.axes):
        geometric.draw(geometric.prepare(short, short.points[0]), short.seed, [0])


def run(target: Path, corpus_folder: Path) -> None:
    """Load a run's folder, and evaluate it against the dataset that it was on."""
    made = runs.load(target)
    known = truths.of(made, corpus_folder / (corpus.DATASET if made.time is None else corpus.VIDEO))
    _judged(made, known)


def film_truth(target: Path, corpus_folder: Path) -> None:
    """Evaluate a run on a video against its truth table."""
    made = runs.load(corpus_folder / corpus.RUN_OF_VIDEO)
    _judged(made, truths.of(made, target))


def _judged(made: runs.Run, known: truths.Truths) -> None:
    found = evaluate(made, known)
    json.dumps(found.to_dict())
    assert tables(found.to_dict())


def dataset(target: Path, _corpus: Path) -> None:
    """Read a dataset's labels and its first picture."""
    found = datasets.read(target)
    for row in found.rows:
        found.weather(row)
        found.is_labelled(row)
    frame_files.picture(found.image(found.rows[0]), found.rows[0])
    open_source(target)


def table(target: Path, corpus_folder: Path) -> None:
    """Estimate from a table of pixels, by one estimator or another."""
    names = [name for name, kind in ESTIMATORS.items() if not kind.needs_time]
    chosen = names[sum(target.read_bytes()) % len(names)]
    measured = judge.measure(target, corpus_folder / corpus.CAMERA, chosen)
    json.dumps(judge.as_json(measured))
    show(measured.estimate)


def pictures(target: Path, corpus_folder: Path) -> None:
    """Go through a folder of pictures as `simgrab run` does, and then as `simgrab detect` does."""
    _look(open_source(target), corpus_folder)
    detections.detect(target, _Blind())


class _Blind:
    """A detector without a net."""

    name = "blind"

    def __call__(self, picture: np.ndarray) -> Detection:
        return Detection("none", f"{picture.shape} and blind", 0.0)


def video(target: Path, corpus_folder: Path) -> None:
    """Decode the first frames of a video."""
    _look(open_source(target), corpus_folder)


def _look(source: Source, corpus_folder: Path) -> None:
    """Decode frames, whether they are of the camera or not, and then see to it that they are."""
    sizes = []
    for frame in itertools.islice(source, DECODED):
        assert (frame.picture is None) == bool(frame.reason)
        if frame.picture is not None:
            assert frame.picture.dtype == np.uint8
            assert frame.picture.shape[2:] == (3,)
            sizes.append(frame.picture.shape[1::-1])
    camera = _camera(corpus_folder)
    if sizes:
        camera = msgspec.structs.replace(camera, width_px=sizes[0][0], height_px=sizes[0][1], digit_layout=None)
    for frame in itertools.islice(fitting(iter(source), camera), DECODED):
        assert frame.picture is None or frame.picture.shape[1::-1] == (camera.width_px, camera.height_px)


def net(target: Path, _corpus: Path) -> None:
    """Open a detector, and run it on a blank picture."""
    opened = detector(target)
    assert opened.name
    opened(np.zeros((64, 64, 3), np.uint8))


OPENERS: dict[str, Opener] = {
    "scenario": scene, "manifest": scene, "set": assignments, "camera": camera, "layout": layout, "tilt": tilt,
    "suite": suites,
    "baseline": baselines, "study": study, "run": run, "truth": film_truth, "dataset": dataset, "table": table,
    "picture": pictures, "video": video, "detector": net,
}  # fmt: skip
