"""A batch learned from in parts gives the gradients of the whole, whatever the threads are doing."""

import subprocess
import sys

import pytest

torch = pytest.importorskip("torch")

from simgrab.training.copies import Copies  # noqa: E402


def net(*norms):
    torch.manual_seed(0)
    return torch.nn.Sequential(
        torch.nn.Conv2d(1, 4, 3), *norms, torch.nn.ReLU(), torch.nn.Flatten(), torch.nn.Linear(4 * 36, 1)
    )


def loss(learner, batch):
    return ((learner(batch["x"])[:, 0] - batch["y"]) ** 2).mean()


def batch(size):
    generator = torch.Generator().manual_seed(1)
    return {"x": torch.rand(size, 1, 8, 8, generator=generator), "y": torch.rand(size, generator=generator)}


@pytest.mark.parametrize("size", [7, 16, 29])  # one part, equal parts, and parts of different sizes
def test_parts_add_up_to_the_whole(size):
    whole, parted = net(), net()
    value = Copies(whole, 1).gradients(loss, batch(size))
    assert Copies(parted, 3).gradients(loss, batch(size)) == pytest.approx(value, rel=1e-6)
    for mine, its in zip(whole.parameters(), parted.parameters(), strict=True):
        torch.testing.assert_close(mine.grad, its.grad)


def test_copies_follow_the_weights_and_forget_the_last_gradients():
    whole, parted = net(), net()
    copies, one = Copies(parted, 2), Copies(whole, 1)
    optimisers = [torch.optim.AdamW(learner.parameters(), lr=0.01) for learner in (whole, parted)]
    for _ in range(5):
        for shared, optimiser in zip((one, copies), optimisers, strict=True):
            shared.gradients(loss, batch(24))
            optimiser.step()
    for mine, its in zip(whole.parameters(), parted.parameters(), strict=True):
        torch.testing.assert_close(mine, its, rtol=1e-4, atol=1e-5)


def test_the_same_threads_give_the_same_bytes():
    def learned():
        learner = net(torch.nn.BatchNorm2d(4))
        copies, optimiser = Copies(learner, 2), torch.optim.SGD(learner.parameters(), lr=0.1)
        for _ in range(5):
            copies.gradients(loss, batch(16))
            optimiser.step()
        return learner.state_dict()

    first, second = learned(), learned()
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert first["1.running_mean"].abs().sum() > 0


def test_this_thread_keeps_its_threads():
    """In a process of its own: torch fixes a thread's number once, at its first work."""
    code = """
import torch
from simgrab.training.copies import Copies
torch.set_num_threads(2)
copies = Copies(torch.nn.Linear(4, 1), 2)
copies.gradients(lambda net, part: net(part["x"]).mean(), {"x": torch.ones(16, 4)})
print(torch.get_num_threads())
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert told.stdout.split() == ["2"]
