"""The price of a dataset, printed before it is rendered."""

from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from conftest import SMALL, as_options, small_scene

import simgrab
from simgrab.cli import cli
from simgrab.dataset import price
from simgrab.dataset.pool import Workers
from simgrab.dataset.render import render
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator

COSTS = {64: 7.0, 16: 3.0, 8: 1.0, 1: 0.25}  # s, of a frame that begins so many
CHECK = 2.0  # of a world


class Serial(Workers):
    """Several workers whose work is done here, one after another."""

    def map(self, work, units, **_options):
        yield from (work(FrameGenerator(self.recipe), unit, lambda: None) for unit in units)


def begins(frame):
    return next(period for period in COSTS if frame % period == 0)


@pytest.fixture
def costing(monkeypatch):
    """Replaces the clock, and frames and checks of worlds by ones that take given times, s."""
    clock = SimpleNamespace(now=0.0)

    def cost(seconds_of, bytes_of=lambda _: 0, *, check=0.0, cores=8):
        def make(_generator, frame):
            clock.now += seconds_of(frame)
            return SimpleNamespace(files={"a.jpg": bytes(bytes_of(frame))}, record=None)

        def vet(_recipe, _frames):
            clock.now += check

        clocks = SimpleNamespace(perf_counter=lambda: clock.now, process_time=lambda: clock.now)
        monkeypatch.setattr(price.stored, "make", make)
        monkeypatch.setattr(price, "vet", vet)
        monkeypatch.setattr(price, "time", clocks)
        monkeypatch.setattr(price.machine, "cores", lambda: cores)

    return cost


@pytest.mark.parametrize(("workers", "cores", "share"), [(1, 4, 1), (2, 4, 1 / 2), (4, 2, 1 / 2)])
def test_the_price_is_the_sum_of_all_frames_where_each_kind_takes_the_same(costing, workers, cores, share):
    costing(lambda frame: COSTS[begins(frame)], lambda frame: 1000 * begins(frame), check=CHECK, cores=cores)
    for frames in (1000, 777):
        scene = simgrab.load("training", {"frames": frames, "every": {"place": 64, "grab": 16}})
        found = price.measured(Serial(Recipe(scene), workers))
        places = -(-frames // 64)
        rendered = sum(COSTS[begins(frame)] for frame in range(frames))
        assert found.seconds == pytest.approx(share * (places * CHECK + rendered))
        assert found.size == sum(1000 * begins(frame) + len(b"null") for frame in range(frames))
        assert found.worlds == -(-frames // 8)
        assert 2 * 5 <= found.tried <= 4 * 5
    same = simgrab.load("quay-day", {"frames": 1000})
    assert price.measured(Serial(Recipe(same), 1)).worlds == 1


@pytest.mark.parametrize("clip_frames", [1, 2, 4, 7, 8, 16])
@pytest.mark.parametrize("world", [0.5, 3.0, 30.0])
def test_the_key_that_saves_time_is_named_where_few_frames_share_a_world(costing, clip_frames, world):
    made = [-1]

    def seconds(frame):
        made.append(frame // clip_frames)
        return 1.0 + world * (made[-1] != made[-2])

    costing(seconds)
    found = price.measured(Serial(Recipe(simgrab.load("training", {"clip.clip_frames": clip_frames})), 1))
    assert found.seconds == pytest.approx(800 * (1 + world / clip_frames), rel=0.01)
    assert ("clip.clip_frames" in str(found)) == (clip_frames < 8 and world > clip_frames)


@pytest.mark.parametrize(("clip_frames", "workers", "share"), [(0, 4, 1), (100, 4, 1 / 4), (500, 4, 1 / 2)])
def test_a_videos_price_is_its_bit_rate_and_a_process_for_each_clip(costing, clip_frames, workers, share):
    costing(lambda _: 1.0, lambda _: 1000)
    clip = {"clip_frames": clip_frames, "frame_rate_hz": 10.0, "bit_rate_mbit_s": 2.0}
    scene = simgrab.load("work-cycles", {"frames": 1000, "clip": clip})
    alone, both = (price.measured(Serial(Recipe(scene), workers), files=files, video=True) for files in (False, True))
    assert alone.seconds == both.seconds == pytest.approx(1000 * share)
    assert (alone.size, both.size - alone.size) == (25_000_000, 1000 * 1004)


@pytest.mark.parametrize(("more", "stated"), [(0, " kB, est"), (600, " (± "), (3000, " MB, or a few times as much, ")])
def test_the_error_of_the_size_is_stated_where_places_differ(costing, more, stated):
    costing(lambda _: 1.0, lambda frame: 1000 + more * (frame >= 400))
    found = price.measured(Serial(Recipe(simgrab.load("training", {"frames": 800})), 1))
    assert stated in str(found)
    assert abs(found.size - 800 * (1004 + more / 2)) <= found.size_error * found.size + 4


def test_many_frames_are_priced_before_the_first_and_few_are_not(monkeypatch, tmp_path):
    monkeypatch.setattr(price, "FEW", 3)
    small = ["render", "quay-day", *as_options(SMALL)]
    monkeypatch.chdir(tmp_path)
    for output in (["--out", "many"], ["--video", "a.mp4"], ["--video", "b.mp4", "--out", "both"]):
        many = CliRunner().invoke(cli, [*small, "--frames", "3", *output])
        assert "3 frames: about " in many.output
    few = CliRunner().invoke(cli, [*small, "--frames", "2", "--out", str(tmp_path / "few")])
    assert (many.exit_code, few.exit_code) == (0, 0)
    assert "about" not in few.output


def test_workers_that_priced_a_dataset_render_the_same(tmp_path):
    scene = small_scene(
        frames=4, clip__clip_frames=2, vary={"camera.beta_deg": {"dist": "uniform", "low": 2, "high": 6}}
    )
    priced = []
    render(scene, tmp_path / "two", workers=2, priced=priced.append)
    render(scene, tmp_path / "one")
    (found,) = priced
    assert (found.frames, found.worlds, found.tried) == (4, 2, 4)
    assert found.size == pytest.approx(sum(f.stat().st_size for f in (tmp_path / "one/images").rglob("*.jpg")), rel=0.3)
    one, two = ((tmp_path / name / "labels.parquet").read_bytes() for name in ("one", "two"))
    assert one == two
    pictures = [sorted((tmp_path / name / "images").rglob("*.jpg")) for name in ("one", "two")]
    assert [p.read_bytes() for p in pictures[0]] == [p.read_bytes() for p in pictures[1]]


@pytest.mark.parametrize(("seconds", "text"), [(44, "44 seconds"), (150, "2.5 minutes"), (46_800, "13 hours")])
def test_times_are_given_to_two_digits(seconds, text):
    assert text in str(price.Price(10, 1, seconds, 10, 1))
