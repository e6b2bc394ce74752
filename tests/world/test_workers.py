"""How many processes `simgrab render` starts by itself."""

from types import SimpleNamespace

import msgspec
import psutil
import pytest
from commands import run
from conftest import as_options, small_scene

import simgrab
from simgrab.dataset import pool, render
from simgrab.runtime import machine
from simgrab.world.extensions import Extensions, Recipe
from simgrab.world.frames import FrameGenerator

TRAINING = simgrab.load("training")


@pytest.fixture
def computer(monkeypatch, tmp_path):
    def have(cores, gigabytes):
        monkeypatch.setattr(psutil.Process, "cpu_affinity", lambda _: list(range(cores)), raising=False)
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=int(gigabytes * 1e9)))
        monkeypatch.setattr(machine, "CGROUP", tmp_path)

    return have


@pytest.mark.parametrize(
    ("cores", "gigabytes", "scene", "by_clip", "expected"),
    [
        (8, 64, small_scene(frames=10_000), False, (8, "8 cores")),
        (8, 64, small_scene(frames=100), False, (1, "100 frames")),
        (8, 64, small_scene(frames=700), False, (4, "700 frames")),
        (8, 4, small_scene(frames=10_000), False, (2, "memory")),
        (
            8,
            8,
            simgrab.load("quay-day", {"frames": 10_000, "image.samples": 8}, size=(3840, 2160)),
            False,
            (1, "memory"),
        ),
        (8, 0.5, small_scene(frames=10_000), False, (1, "memory")),
        (4, 64, TRAINING, False, (4, "4 cores")),
        (4, 64, msgspec.structs.replace(TRAINING, frames=24), False, (1, "3 worlds")),
        (8, 64, small_scene(frames=10_000), True, (1, "1 clips")),
    ],
)
def test_processes_are_as_many_as_pay(computer, cores, gigabytes, scene, by_clip, expected):
    computer(cores, gigabytes)
    assert pool.automatic(Recipe(scene), by_clip=by_clip) == expected


def test_the_command_says_how_many_and_why(tmp_path):
    small = [*as_options({"frames": 1, "place.model": "plain"}), "--size", "160x90"]
    assert "worker processes: 1 (limited by 1 frames)" in "".join(
        run("render", "quay-day", *small, "--out", tmp_path / "out")[1:]
    )


def test_functions_that_no_worker_can_be_given_leave_one_process(computer):
    computer(8, 64)
    recipe = Recipe(small_scene(frames=10_000), Extensions(effects=(lambda rgb, *_: rgb,)))
    assert pool.automatic(recipe) == (1, "functions that worker processes cannot be given")


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, (8, 64_000_000_000)),
        ({"cpu.max": "200000 100000", "memory.max": "4000000000", "memory.current": "1000000000"}, (2, 3_000_000_000)),
        ({"cpu.max": "50000 100000", "memory.max": "1000", "memory.current": "2000"}, (1, 0)),
        ({"cpu.max": "max 100000", "memory.max": "max", "memory.current": "5"}, (8, 64_000_000_000)),
    ],
)
def test_a_containers_limits_hold(computer, tmp_path, files, expected):
    computer(8, 64)
    for name, text in files.items():
        (tmp_path / name).write_text(text + "\n")
    assert (machine.cores(), machine.free_bytes()) == expected


def test_checking_worlds_together_finds_what_checking_each_finds():
    scene = simgrab.load("training", {"frames": 24, "every": {"place": 16, "grab": 16, "swing": 16}})
    recipe, ticks = Recipe(scene), list[int]()
    together = pool.vet(recipe, range(24), lambda: ticks.append(1))
    each = [pool.vet(recipe, scene.span(clip)) for clip in range(3)]
    assert (together.seen, len(ticks)) == (sum(one.seen for one in each), 3)
    for frame, projection in ((f, p) for one in each for f, p in one.projections.items()):
        assert (together.projections[frame].centre_camera == projection.centre_camera).all()
        assert (together.projections[frame].keypoints_camera == projection.keypoints_camera).all()


def test_a_world_that_was_checked_is_not_planned_again():
    recipe = Recipe(small_scene(frames=2))
    plan = pool.vet(recipe).plan
    assert FrameGenerator(recipe, plan).planned(1).plan is plan


@pytest.mark.parametrize(
    ("frames", "workers", "sizes"),
    [
        (640, 2, [64] * 10), (160, 2, [64, 64, 16, 16]), (640, 8, [64] * 8 + [16] * 8),
        (320, 8, [40] * 8), (64, 16, [8] * 8),
        (10, 8, [8, 2]), (160, 1, [64, 64, 32]),
    ],
)  # fmt: skip
def test_the_last_frames_of_a_draw_are_shared_by_all_processes(frames, workers, sizes, tmp_path):
    """Each process builds what they share, in less time than it would wait for another one to make them all."""
    recipe = Recipe(simgrab.load("training-large", {"frames": frames}))
    folder = render._Folder(recipe, tmp_path, None, None, workers)
    units = folder._groups(range(frames))
    assert [len(unit) for unit in units] == sizes
    assert [frame for unit in units for frame in unit] == list(range(frames))
    assert all(unit[0] % 8 == 0 for unit in units)
