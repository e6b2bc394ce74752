import itertools

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from simgrab.dataset.tables import calibration_of
from simgrab.errors import LayoutError, ReaderError
from simgrab.instrument.read import Hoist, Reader, consistent
from simgrab.instrument.read.crops import crops
from simgrab.instrument.read.reader import reading
from simgrab.io.pictures import encode
from simgrab.io.resources import ASSETS
from simgrab.model import layouts, scenes
from simgrab.model.rng import stream
from simgrab.world.camera.overlay import Overlay
from simgrab.world.frames import FrameGenerator
from simgrab.world.trajectory.display import Shown

CLOCK = "2022年01月26日 星期三 14:05:37"
PICTURES = [(name, size) for name in layouts.names() for size in ((1920, 1080), (1280, 720))]
CHEAP = {"place": {"model": "plain"}, "image.samples": 0, "image.shadow_map_px": 0, "frames": 1}


@pytest.fixture(scope="module")
def reader():
    return Reader()


def backdrops(width, height, count=2):
    """Slopes, hard edges and noise, from black to white."""
    rng = np.random.default_rng(3)
    for _ in range(count):
        slope = np.linspace(*rng.uniform(0, 255, 2), width)[None, :, None] * rng.random((1, 1, 3))
        blocks = np.kron(rng.integers(0, 256, (height // 30, width // 40, 3)), np.ones((30, 40, 1)))
        yield (slope + 0.3 * blocks + rng.normal(0, 8, (height, width, 3))).clip(0, 255).astype(np.uint8)


def displays(layout, pictures, count, quality):
    """Random digits laid over pictures, coded as JPEG: decoded RGB, and the text."""
    overlay = Overlay(layout)
    for k in range(count):
        text = layout.written("".join(map(str, stream(5, k, "displays").integers(0, 10, 8))))
        picture = overlay.blend(pictures[k % len(pictures)], Shown(CLOCK, text, text, None))
        data = encode(picture[..., ::-1], "jpeg", quality)
        yield cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1], text


def shares(reader, name, size, count, quality=60):
    """Share of digits read right, and of those refused, of displays laid over backdrops."""
    layout = layouts.load(name).scaled(*size)
    right = refused = 0
    for rgb, text in displays(layout, list(backdrops(*size)), count, quality):
        found = reader.read(rgb, layout).text
        pairs = [(a, b) for a, b in zip(found, text, strict=True) if b.isdigit()]
        right += sum(a == b for a, b in pairs)
        refused += sum(a == "?" for a, _ in pairs)
    return right / (8 * count), refused / (8 * count)


@pytest.mark.parametrize(("name", "size"), PICTURES)
def test_the_bundled_reader_reads_random_displays(reader, name, size):
    right, refused = shares(reader, name, size, 40)
    assert right + refused == 1
    assert right >= 0.996


@pytest.mark.parametrize(("scene", "name"), [
    ("calm-day", "two-by-four"), ("night-light-snow", "four-point-four"), ("heavy-snow", "two-by-four"),
])  # fmt: skip
def test_the_bundled_reader_reads_rendered_frames(reader, scene, name):
    scenario = scenes.load(scene, CHEAP | {"display.layout": name})
    known = calibration_of(scenario)
    with FrameGenerator(scenario) as generator:
        for frame in range(scenario.frames):
            drawn = generator.frame(frame)
            text, moment = drawn.moment.shown.rope_text, drawn.moment
            found = reader.read(drawn.rgb, known.digit_layout)
            assert (found.status, found.text) == ("read", text)
            rope_length = found.hoist_m + known.display_constant_m
            assert rope_length == pytest.approx(moment.grab.rope_length, abs=0.0051)


def test_a_users_own_layout(reader, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        (ASSETS / "osd" / "two-by-four.toml").read_text()
        .replace("decimals = 2", "decimals = 1")
        .replace("[1748, 32], [1780, 32], [1812, 32], [1844, 32]", "[300, 500], [340, 500], [400, 520], [440, 520]")
    )  # fmt: skip
    layout = layouts.read(path)
    picture = Overlay(layout).blend(next(backdrops(1920, 1080)), Shown(CLOCK, "0246 1357", "0246 1357", None))
    found = reader.read(picture, layout)
    assert (found.hoist_text, found.closing_text) == ("0246", "1357")
    assert found.hoist_m == pytest.approx(24.6)


def test_a_smaller_stream_of_the_same_shape_needs_no_other_layout(reader):
    layout, small = layouts.load("four-point-four"), layouts.load("four-point-four").scaled(1280, 720)
    text = small.text(20.15, 21.37)
    picture = Overlay(small).blend(next(backdrops(1280, 720)), Shown(CLOCK, text, text, None))
    assert reader.read(picture, layout).text == text


def test_grey_and_colour_read_alike(reader):
    layout = layouts.load("two-by-four")
    grey = next(backdrops(1920, 1080)).mean(axis=2).astype(np.uint8)
    picture = Overlay(layout).blend(np.repeat(grey[..., None], 3, axis=2), Shown(CLOCK, "2015 2137", "2015 2137", None))
    np.testing.assert_allclose(crops(picture, layout), crops(picture[..., 0], layout), atol=1e-6)
    assert reader.read(picture[..., 0], layout).text == "2015 2137"


@pytest.mark.parametrize("kind", ["black", "white", "noise", "blocks"])
def test_a_picture_without_a_display_is_refused(reader, kind):
    rng = np.random.default_rng(0)
    picture = {
        "black": np.zeros((1080, 1920, 3), np.uint8),
        "white": np.full((1080, 1920, 3), 255, np.uint8),
        "noise": rng.integers(0, 256, (1080, 1920, 3), np.uint8),
        "blocks": next(backdrops(1920, 1080)),
    }[kind]
    for name in layouts.names():
        found = reader.read(picture, layouts.load(name))
        assert found.status == "refused"
        assert found.reason
        assert "?" in found.text
        assert found.hoist_m is None


def test_a_torn_display_is_read_as_one_text_or_refused(reader):
    """Row by row; digits whose halves make up a third are what a reader of single digits cannot tell."""
    layout, picture = layouts.load("two-by-four"), next(backdrops(1920, 1080))
    overlay, old, new = Overlay(layout), "2015 2137", "1894 0266"
    for row in range(33, 132):
        found = reader.read(overlay.blend(picture, Shown(CLOCK, old, new, row)), layout)
        numbers = zip(found.text.split(), old.split(), new.split(), strict=True)
        assert found.status == "refused" or all(number in pair for number, *pair in numbers if "?" not in number)


def test_doubt_is_refused_and_said():
    layout, sure = layouts.load("four-point-four"), np.full((8, 11), 0.01, np.float32)
    sure[range(8), [2, 0, 1, 5, 2, 1, 0, 0]] = 0.9
    found = reading(sure, layout, 0.8)
    assert (found.status, found.text, found.hoist_m) == ("read", "20.15 21.00", 20.15)
    found = reading(sure, layout, 0.95)
    assert (found.status, found.text) == ("refused", "??.?? ??.??")
    sure[5, 1], sure[6, 0] = 0.7, 0.0
    sure[6, 10] = 0.9
    found = reading(sure, layout, 0.8)
    assert (found.status, found.text, found.reason) == ("read", "20.15 2?.?0", "")  # the hoist rope is enough
    assert found.hoist_m == 20.15
    sure[3, 5] = 0.7
    found = reading(sure, layout, 0.8)
    assert (found.status, found.text, found.hoist_m) == ("refused", "20.1? 2?.?0", None)
    assert found.reason == "hoist.3 may be a 5, at 0.70 below the threshold of 0.80, and 2 more"


def test_one_clear_message(reader):
    layout = layouts.load("two-by-four")
    for picture, words in (
        (np.zeros((1080, 1920, 3)), "uint8, got float64"),
        (None, "uint8, got NoneType"),
        (np.zeros((1080, 1920, 4), np.uint8), r"\(1080, 1920, 4\)"),
        (np.zeros((1080, 1440, 3), np.uint8), "does not have the aspect ratio of the layout"),
        (np.zeros((1920, 1080, 3), np.uint8), "aspect ratio"),
    ):
        with pytest.raises(ReaderError, match=words):
            reader.read(picture, layout)
    with pytest.raises(LayoutError, match="cannot be read"):
        reader.read(np.zeros((135, 240, 3), np.uint8), layout)


# Consistency. Records are made as a crane makes them: speeds below the hoist's, held and rounded by the display.


@st.composite
def records(draw, least=20, most=150):
    """Times and lengths of an honest record: lag, refresh, trembling stamps, lost frames."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    rate, lag, refresh = draw(st.floats(2, 30)), draw(st.floats(0, 1)), draw(st.floats(5, 20))
    n = draw(st.integers(least, most))
    taken = np.arange(n) / rate
    edges = np.arange(-2, n / rate + 2, draw(st.floats(0.2, 5)))
    full = draw(st.booleans())
    speeds = rng.choice([-1, 1], len(edges)) if full else rng.uniform(-1, 1, len(edges))
    path = np.concatenate([[0], np.cumsum(speeds[:-1] * np.diff(edges))]) * Hoist().speed_m_s + 50
    held = np.floor(taken * refresh) / refresh - lag
    lengths = np.round(np.interp(held, edges, path), 2)
    times = taken + rng.uniform(-0.05, 0.05, n).clip(-0.4 / rate, 0.4 / rate)
    kept = rng.random(n) >= draw(st.sampled_from([0.0, 0.1, 0.5]))
    kept[:2] = True
    return times[kept], lengths[kept]


@given(records())
@settings(max_examples=200, deadline=None)
def test_an_honest_record_is_believed_whole(record):
    assert consistent(*record).all()


@given(records(least=80), st.floats(0, 1), st.floats(3, 30), st.sampled_from([-1, 1]))
@settings(max_examples=100, deadline=None)
def test_wrong_readings_are_not_believed(record, place, off, side):
    """A short stretch anywhere, metres off, among honest readings twice as many as it has."""
    times, lengths = record
    begins = times[int(place * (len(times) - 1))]
    wrong = (times >= begins) & (times < begins + 0.3)
    takes = (off - 0.01) / Hoist().speed_m_s - 0.4  # for the hoist to get there
    around = ~wrong & (np.abs(times - begins) < takes / 4)
    assume(around.sum() > 2 * wrong.sum())
    believed = consistent(times, lengths + np.where(wrong, side * off, 0.0))
    assert not believed[wrong].any()
    assert believed[~wrong].mean() > 0.5


def steady(n=90, rate=9.0):
    times = np.arange(n) / rate
    return times, 20 + 1.0 * times


@pytest.mark.parametrize("wrong", [[0], [0, 1, 2], [40], [89], list(range(40, 52)), [3, 9, 40, 41, 60]])
def test_exactly_the_wrong_ones_are_flagged(wrong):
    times, lengths = steady()
    lengths[wrong] += 3.0
    assert np.flatnonzero(~consistent(times, lengths)).tolist() == wrong


def test_a_jump_over_a_gap_is_a_jump_only_if_the_gap_is_too_short():
    times, lengths = np.array([0, 1, 2, 3, 5.0, 6, 7, 8]), np.array([20, 20, 20, 20, 23.0, 23, 23, 23])
    # 3 m in 2 s: the reading before or the one after is wrong, and as much speaks for either.
    assert np.flatnonzero(~consistent(times, lengths)).tolist() == [3, 4]
    assert consistent(times + 1.0 * (times > 4), lengths).all()


def test_missing_readings_are_not_believed_and_accuse_nobody():
    times, lengths = steady()
    lengths[10:30] = np.nan
    assert np.flatnonzero(~consistent(times, lengths)).tolist() == list(range(10, 30))
    assert not consistent(times, np.full(90, np.nan)).any()
    assert consistent(np.empty(0), np.empty(0)).shape == (0,)


def brute(times, lengths, hoist):
    """By trying every subset."""
    n = len(times)
    chains = []
    for size in range(n, 0, -1):
        for chain in itertools.combinations(range(n), size):
            steps = itertools.pairwise(chain)
            if all(abs(lengths[b] - lengths[a]) <= hoist.reach(times[b] - times[a]) + 1e-9 for a, b in steps):
                chains.append(set(chain))
        if chains:
            break
    common = set.intersection(*chains)
    return [i in common for i in range(n)]


@given(st.lists(st.tuples(st.integers(1, 30), st.integers(0, 60)), min_size=1, max_size=8))
@settings(max_examples=150, deadline=None)
def test_it_is_what_every_longest_chain_has_in_common(steps):
    times, lengths = np.cumsum([dt for dt, _ in steps]) / 10, np.array([r for _, r in steps]) / 10
    hoist = Hoist()
    assert consistent(times, lengths, hoist).tolist() == brute(times, lengths, hoist)


def test_wrong_times_raise():
    for times in ([0.0, 0.0, 1.0], [0.0, np.nan, 1.0], [0.0, 1.0]):
        with pytest.raises(ValueError, match="times"):
            consistent(np.array(times), np.zeros(3))
