"""How many processes `simgrab render` starts by itself."""

from types import SimpleNamespace

import msgspec
import psutil
import pytest
from click.testing import CliRunner
from conftest import as_options, small_scene

import simgrab
from simgrab.cli import cli
from simgrab.world.extensions import Recipe
from simgrab.world.output import pool

TRAINING = simgrab.load("training")


@pytest.fixture
def machine(monkeypatch):
    def have(cores, gigabytes):
        monkeypatch.setattr(psutil.Process, "cpu_affinity", lambda _: list(range(cores)), raising=False)
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=int(gigabytes * 1e9)))

    return have


@pytest.mark.parametrize(
    ("cores", "gigabytes", "scene", "by_clip", "expected"),
    [
        (8, 64, small_scene(frames=10_000), False, (8, "8 cores")),
        (8, 64, small_scene(frames=100), False, (1, "100 frames")),
        (8, 64, small_scene(frames=700), False, (4, "700 frames")),
        (8, 6, small_scene(frames=10_000), False, (2, "memory")),
        (8, 0.5, small_scene(frames=10_000), False, (1, "memory")),
        (4, 64, TRAINING, False, (4, "4 cores")),
        (4, 64, msgspec.structs.replace(TRAINING, frames=24), False, (1, "3 worlds")),
        (8, 64, small_scene(frames=10_000), True, (1, "1 clips")),
    ],
)
def test_processes_are_as_many_as_pay(machine, cores, gigabytes, scene, by_clip, expected):
    machine(cores, gigabytes)
    assert pool.automatic(Recipe(scene), by_clip=by_clip) == expected


def test_the_command_says_how_many_and_why(tmp_path):
    command = ["render", "quay-day", *as_options({"frames": 1}), "--size", "160x90", "--out", str(tmp_path / "out")]
    assert "worker processes: 1 (as many as 1 frames can use)" in CliRunner().invoke(cli, command).output
    again = CliRunner().invoke(cli, [*command[:-1], str(tmp_path / "two"), "--workers", "0"])
    assert again.exit_code == 2
    assert "--workers" in again.output
