import dataclasses
import os
import pickle
import subprocess
import sys
import zipfile
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from simgrab.errors import TrainingError  # noqa: E402
from simgrab.training import loop  # noqa: E402
from simgrab.training.recipe import TrainingRecipe  # noqa: E402

RECIPE = TrainingRecipe(epochs=6, batch=16, rate=3e-2, average=0.9, threads=1)
ONE = dataclasses.replace(RECIPE, epochs=1)


class Line:
    """Learns y = 3x − 1 from noisy points; dropout, so that torch's own chance matters too."""

    examples = 70

    def __init__(self):
        self.x = np.linspace(-1, 1, 70, dtype=np.float32)
        self.seen = []

    def batch(self, chosen, rng):
        self.seen.append(chosen)
        x = self.x[chosen] + rng.normal(0, 0.01, len(chosen)).astype(np.float32)
        return {"x": torch.from_numpy(x)[:, None], "y": torch.from_numpy(3 * x - 1)[:, None]}

    def loss(self, net, batch):
        return (net(batch["x"]) - batch["y"]).square().mean()

    def validate(self, net):
        x = torch.from_numpy(self.x)[:, None]
        return {"score": -float((net(x) - (3 * x - 1)).square().mean())}


def line(**changes):
    task = Line()
    vars(task).update(changes)
    return task


def build():
    return torch.nn.Sequential(
        torch.nn.Linear(1, 16), torch.nn.BatchNorm1d(16), torch.nn.ReLU(), torch.nn.Dropout(0.1), torch.nn.Linear(16, 1)
    )


def train(out, recipe=RECIPE, task=None, net=build, **options):
    out.mkdir(exist_ok=True)
    return loop.train(net, task or Line(), recipe, out, **options)


def weights(trained):
    return torch.cat([value.flatten().double() for value in trained.net.state_dict().values()])


def test_it_learns(tmp_path):
    scores = []
    keep = lambda now: scores.extend([now.figures["score"]] if now.figures else ())  # noqa: E731
    trained = train(tmp_path, dataclasses.replace(RECIPE, epochs=40), report=keep)
    assert scores[0] < -0.5
    assert trained.figures["score"] == max(scores) > -0.1
    assert not trained.net.training
    assert Line().validate(trained.net)["score"] == trained.figures["score"]  # the best epoch's weights came back


class Sum(torch.nn.Module):
    """Two layers of which one learns at a share of the rate."""

    def __init__(self):
        super().__init__()
        self.fast, self.slow = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
        self.slow.share = 0.25
        for weight in self.parameters():
            torch.nn.init.zeros_(weight)

    def forward(self, x):
        return self.fast(x) + self.slow(x)


def test_a_part_learns_at_its_share_of_the_rate(tmp_path):
    recipe = dataclasses.replace(RECIPE, weight_decay=0.0)
    net = train(tmp_path, recipe, net=Sum).net
    assert float(net.fast.weight.abs()) > 0.1
    for fast, slow in zip(net.fast.parameters(), net.slow.parameters(), strict=True):
        np.testing.assert_allclose(slow.detach(), 0.25 * fast.detach(), rtol=1e-4)


def test_the_same_seed_gives_the_same_weights(tmp_path):
    seeds = {"a": 0, "b": 0, "c": 1}
    a, b, c = (weights(train(tmp_path / key, dataclasses.replace(RECIPE, seed=seed))) for key, seed in seeds.items())
    assert torch.equal(a, b)
    assert not torch.equal(a, c)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # of Python 3.12, where threads run
def test_a_process_makes_the_same_batches(tmp_path):
    class Where(Line):
        def batch(self, chosen, rng):
            return super().batch(chosen, rng) | {"process": torch.full((len(chosen),), os.getpid())}

        def loss(self, net, batch):
            made_by.update(batch["process"].tolist())
            return super().loss(net, batch)

    cv2.GaussianBlur(np.zeros((2000, 2000, 3), np.uint8), (0, 0), 5)  # starts OpenCV's threads
    threads, made_by, found = cv2.getNumThreads(), set(), []
    for loaders in (0, 1):
        found.append(weights(train(tmp_path / str(loaders), task=Where(), loaders=loaders)))
        assert (os.getpid() in made_by) == (loaders == 0)
        made_by.clear()
    assert torch.equal(*found)
    assert cv2.getNumThreads() == threads


def test_an_epoch_sees_every_example_at_most_once(tmp_path):
    task = Line()
    train(tmp_path, dataclasses.replace(RECIPE, epochs=2), task)
    first, second = np.concatenate(task.seen[:4]), np.concatenate(task.seen[4:])
    assert len(set(first)) == len(first) == 64
    assert list(first) != list(second)


@pytest.mark.parametrize("at", [(1, 3), (3, 4), (5, 1)])
def test_a_killed_training_resumes_to_the_same_weights(tmp_path, at):
    def kill(report):
        if (report.epoch, report.step) == at and not report.figures:
            raise KeyboardInterrupt

    whole = train(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path / "killed", report=kill)
    again = train(tmp_path / "killed", resume=True)
    assert torch.equal(weights(whole), weights(again))
    assert again.figures == whole.figures


def test_it_stops_early_when_nothing_gets_better(tmp_path):
    stuck = line(validate=lambda _net: {"score": 1.0})
    trained = train(tmp_path, dataclasses.replace(RECIPE, patience=2), stuck)
    assert (trained.epoch, trained.epochs) == (1, 3)


def test_another_trainings_checkpoint_is_refused(tmp_path, monkeypatch):
    train(tmp_path, ONE, data="one")
    for change, problem in (
        ({"recipe": RECIPE}, "epochs 1 became 6"), ({"data": "two"}, "data 'one' became 'two'"),
        ({"net": lambda: torch.nn.Linear(1, 1)}, "holds another network"),
    ):  # fmt: skip
        with pytest.raises(TrainingError, match=problem):
            train(tmp_path, **{"recipe": ONE, "data": "one", "resume": True} | change)
    monkeypatch.setattr(loop, "__version__", "99")
    with pytest.raises(TrainingError, match=r"simgrab '.+' became '99'"):
        train(tmp_path, ONE, data="one", resume=True)


class Harm:
    """Pickled, it makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def repacked(path, change):
    """Write a checkpoint's archive anew, its entries changed."""
    with zipfile.ZipFile(path) as archive:
        entries = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries:
            archive.writestr(name, *change(name, content))


def test_nothing_in_a_checkpoint_is_executed(tmp_path):
    harm = Harm(tmp_path / "harmed")
    path = tmp_path / "checkpoint.pt"
    train(tmp_path, ONE)
    sound = path.read_bytes()
    writers = {
        "torch": lambda: torch.save({"identity": harm}, path),
        "older torch": lambda: torch.save({"identity": harm}, path, _use_new_zipfile_serialization=False),
        "pickle": lambda: path.write_bytes(pickle.dumps(harm)),
        "repacked": lambda: (
            path.write_bytes(sound),
            repacked(path, lambda name, old: (pickle.dumps(harm) if name.endswith("data.pkl") else old,)),
        ),
    }
    for name, write in writers.items():
        write()
        with pytest.raises(TrainingError, match="not a simgrab checkpoint") as refused:
            train(tmp_path, resume=True)
        assert "\n" not in str(refused.value)
        assert not harm.path.exists(), name
    pickle.loads(pickle.dumps(harm))
    assert harm.path.exists()  # it would have


def test_damaged_checkpoints_are_refused_in_one_line(tmp_path):
    path = tmp_path / "checkpoint.pt"
    train(tmp_path, ONE)
    sound = path.read_bytes()
    state = torch.load(path, weights_only=True)
    for size in (0, 4, 1000, len(sound) // 2, len(sound) - 1):
        path.write_bytes(sound[:size])
        with pytest.raises(TrainingError, match="not a simgrab checkpoint"):
            train(tmp_path, ONE, resume=True)
    path.write_bytes(sound)
    repacked(path, lambda _, content: (content, zipfile.ZIP_DEFLATED))  # 1 MB may be 1 GB
    with pytest.raises(TrainingError, match="not a simgrab checkpoint"):
        train(tmp_path, ONE, resume=True)
    for foreign in ([1, 2], torch.zeros(3), {"a": 1}, {"identity": "abc"}, {"identity": {1: 2, "x" * 10**5: 3}}):
        torch.save(foreign, path)
        with pytest.raises(TrainingError) as refused:
            train(tmp_path, ONE, resume=True)
        assert len(str(refused.value)) < 1000
    torn = state["optimiser"] | {"state": {0: {"exp_avg": torch.zeros(7), "step": torch.zeros(())}}}
    hostile = {
        "net": 3, "average": [], "optimiser": "adam", "best": {}, "best_epoch": 2**70, "history": [{"score": "good"}],
        "seconds": [],
    }  # fmt: skip
    for changed in (*({key: value} for key, value in hostile.items()), {"optimiser": torn}, {"history": []}):
        torch.save(state | changed, path)
        with pytest.raises(TrainingError, match="is damaged"):
            train(tmp_path, ONE, resume=True)
    for key in hostile:
        torch.save({name: value for name, value in state.items() if name != key}, path)
        with pytest.raises(TrainingError, match="is damaged"):
            train(tmp_path, ONE, resume=True)
    path.write_bytes(sound)
    train(tmp_path, ONE, resume=True)


@pytest.mark.parametrize(
    "problem", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 1 byte")]
)
def test_out_of_memory_is_one_line(tmp_path, problem):
    with pytest.raises(TrainingError, match="out of memory with batches of 16"):
        train(tmp_path, task=line(loss=Mock(side_effect=problem)))


def test_what_cannot_be_trained_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="no training examples"):
        train(tmp_path, task=line(examples=0))
    with pytest.raises(TrainingError, match="loss of step 0 is nan"):
        train(tmp_path, task=line(loss=lambda net, batch: net(batch["x"]).mean() * float("nan")))
    with pytest.raises(TrainingError, match="device 'abacus'"):
        train(tmp_path, dataclasses.replace(RECIPE, device="abacus"))
    with pytest.raises(TrainingError, match="epochs"):
        TrainingRecipe(epochs=0)


def test_the_rate_rises_and_falls():
    rates = [RECIPE.rate_at(x) for x in np.linspace(0, 1, 101)]
    assert max(rates) == pytest.approx(RECIPE.rate)
    assert np.argmax(rates) == 10
    assert rates[0] < RECIPE.rate / 20
    assert rates[-1] < RECIPE.rate / 500
    assert np.all(np.diff(rates[10:]) < 0)


@pytest.mark.slow
def test_drawing_leaves_room_for_torch():
    """Mesa's LLVM and that in triton, which torch's optimisers import, do not bear each other in the wrong order."""
    code = """
import simgrab.world
import mujoco, torch
from simgrab.world import gl
with gl.offscreen(mujoco.MjSpec().compile(), 64, 64):
    gl.fingerprint()
assert "libtriton" not in open("/proc/self/maps").read()
torch.optim.SGD([torch.zeros(1, requires_grad=True)], 0.1)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
