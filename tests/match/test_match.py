"""What footage shows of its camera, on pictures whose camera is known, and on footage that shows nothing."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from browser import needs_chromium, shown
from films import film
from scipy.special import ndtr

from simgrab.errors import CalibrationError, SourceError
from simgrab.instrument.detect import detector
from simgrab.match import scene as matching
from simgrab.match.footage import Footage, measure, read
from simgrab.match.footage.blur import blur
from simgrab.match.footage.display import DisplayMatch, _lines, _pairs, display
from simgrab.match.footage.footage import BT709
from simgrab.match.footage.grab import Grab, _paint
from simgrab.match.footage.noise import noise
from simgrab.match.footage.quantity import Quantity, exact
from simgrab.match.footage.shading import CELL_PX, FOCAL_PER_WIDTH, vignetting
from simgrab.match.footage.sharpness import EDGE_PX, Sharpness, sharpness
from simgrab.match.footage.still import still
from simgrab.model import calibration, layouts, scenes
from simgrab.model.distributions import Uniform
from simgrab.model.scenario import Sharpening, variants
from simgrab.model.srgb import decoded, encoded
from simgrab.world.camera.optics.chain import sharpened

SIZE = 384, 216
GAIN, READ = 4e-4, 3e-3


def footage(rgb: np.ndarray) -> Footage:
    """Footage of frames, shape (frames, height, width, 3), that no coder has touched."""
    luma = np.rint(rgb @ np.array(BT709)).astype(np.uint8)
    return Footage("made", luma, rgb[::4], "raw", 9.0, 1.0, 10, None, BT709)


def scene(rng: np.random.Generator, diameter: float = 0.0, stops: float = 0.0) -> np.ndarray:
    """Linear light of bars in many directions and levels, blurred by a disc, and darkened outwards."""
    width, height = SIZE
    fine, light = 4, np.full((4 * height, 4 * width), 0.15, np.float32)
    for x in range(20, width - 20, 48):
        for y in range(20, height - 20, 48):
            corners = cv2.boxPoints(((fine * x, fine * y), (fine * 26, fine * 20), float(rng.uniform(0, 90))))
            cv2.fillPoly(light, [corners.astype(np.int32)], float(rng.uniform(0.03, 0.6)))
    if diameter > 1:
        reach = np.arange(-25, 26)
        disc = (np.hypot(reach, reach[:, None]) <= diameter * fine / 2).astype(np.float32)
        light = cv2.filter2D(light, -1, disc / disc.sum())
    light = cv2.resize(light, SIZE, interpolation=cv2.INTER_AREA)
    x, y = np.arange(width) + 0.5 - width / 2, (np.arange(height) + 0.5 - height / 2)[:, None]
    focal = 1644.8 / 1920 * width
    law = np.log1p((x**2 + y**2) / focal**2) / np.log1p((width**2 + height**2) / 4 / focal**2)
    return np.repeat((light * 2.0 ** (-stops * law))[..., None], 3, axis=2)


def taken(light: np.ndarray, rng: np.random.Generator, frames: int = 24) -> np.ndarray:
    """Frames with shot and read noise."""
    sd = np.sqrt(GAIN * light + READ**2)
    return np.stack([
        np.rint(255 * encoded(np.clip(light + sd * rng.standard_normal(light.shape), 0, 1))).astype(np.uint8)
        for _ in range(frames)
    ])  # fmt: skip


def nothing(one: Footage) -> np.ndarray:
    return np.zeros(one.luma.shape[1:], bool)


def holds(found: Quantity, truth: float, **error: float) -> bool:
    """Whether an interval holds the truth, and the value is as near as that."""
    return found.low <= truth <= found.high and found.value == pytest.approx(truth, **error)


def test_noise_of_a_known_sensor_is_found():
    rng = np.random.default_rng(1)
    one = footage(taken(scene(rng), rng))
    found = noise(one, still(one), nothing(one))
    assert holds(found.gain, GAIN, rel=0.1)
    assert found.read.low <= READ <= found.read.high
    assert found.gain.high - found.gain.low < 0.5 * GAIN


@pytest.mark.parametrize("diameter", [0.0, 2.0, 3.5])
def test_blur_of_a_known_lens_is_found(diameter):
    rng = np.random.default_rng(2)
    one = footage(taken(scene(rng, diameter), rng, 8))
    assert holds(blur(one, nothing(one)), max(diameter, 1.0), abs=0.3)


@pytest.mark.parametrize("stops", [0.0, 1.5])
def test_vignetting_of_a_known_lens_is_found(stops):
    rng = np.random.default_rng(3)
    one = footage(taken(scene(rng, stops=stops), rng, 8))
    assert holds(vignetting(one, None, nothing(one)), stops, abs=0.15)


@pytest.mark.parametrize("stops", [0.0, 2.0])
def test_vignetting_of_uneven_ground_is_not_found_too_small(stops):
    rng = np.random.default_rng(4)
    width, height = 640, 360
    x, y = np.arange(width) + 0.5 - width / 2, (np.arange(height) + 0.5 - height / 2)[:, None]
    field = np.log1p((x**2 + y**2) / (FOCAL_PER_WIDTH * width) ** 2)
    ground = rng.normal(0, 0.12, (height // CELL_PX, width // CELL_PX)).repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
    light = 0.3 * np.exp2(ground - stops * field / field.max())
    one = footage(np.rint(255 * encoded(np.tile(light[None, ..., None], (1, 1, 1, 3)))))
    assert holds(vignetting(one, None, nothing(one)), stops, abs=0.2)


def processed(frames: np.ndarray, amount: float, radius: float) -> np.ndarray:
    return np.stack([sharpened(frame, Sharpening(amount=amount, radius_px=radius)) for frame in frames])


def bars(rng: np.random.Generator, edge: float) -> np.ndarray:
    """Levels, 0 to 255, of bars whose edges are a Gaussian's integral of a standard deviation, px."""
    width, height = SIZE
    x, y = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
    level = np.full((height, width), 90.0)
    for u in range(40, width - 40, 80):
        for v in range(40, height - 40, 80):
            angle = rng.uniform(0, np.pi / 2)
            c, s = np.cos(angle), np.sin(angle)
            p, q = c * (x - u) + s * (y - v), c * (y - v) - s * (x - u)
            inside = [ndtr((24 - r) / edge) * ndtr((24 + r) / edge) for r in (p, q)]
            level += rng.uniform(40, 60) * inside[0] * inside[1]
    return np.repeat(level[..., None], 3, axis=2)


@pytest.mark.parametrize(
    ("edge", "amount", "radius"),
    [(0.6, 0.0, 1.0), (1.2, 0.0, 1.0), (0.8, 0.5, 1.0), (0.6, 1.0, 1.4), (1.2, 2.2, 1.6), (0.8, 1.5, 2.5)],
)
def test_overshoot_of_edges_and_the_mask_that_makes_it_are_found(edge, amount, radius):
    rng = np.random.default_rng(12)
    noisy = [np.rint(bars(rng, edge) + rng.normal(0, 1.5, (*SIZE[::-1], 3))).astype(np.uint8) for _ in range(8)]
    one = footage(processed(np.stack(noisy), amount, radius))
    found = sharpness(one, nothing(one))
    x = np.arange(-8, 8.01, 0.1)
    seen = (1 + amount) * ndtr(x / edge) - amount * ndtr(x / np.hypot(edge, radius))
    level = seen[x > 5.4].mean()
    truth = max(100 * (seen.max() - level) / (2 * level - 1), 0.0)
    assert holds(found.overshoot, truth, abs=1 + 0.1 * truth)
    if edge > 1:  # softer than rendered ones: no mask makes these alike
        return
    rendered = (1 + found.amount) * ndtr(x / EDGE_PX) - found.amount * ndtr(x / np.hypot(EDGE_PX, found.radius_px))
    level = rendered[x > 5.4].mean()
    alike = 100 * (rendered.max() - level) / (2 * level - 1)
    assert alike == pytest.approx(truth, abs=3 + 0.15 * truth)


def test_blurred_edges_do_not_overshoot_and_footage_without_edges_shows_nothing():
    rng = np.random.default_rng(13)
    blurred = footage(taken(scene(rng, 4.0), rng, 8))
    assert sharpness(blurred, nothing(blurred)).amount == 0
    even = footage(taken(np.full((*SIZE[::-1], 3), 0.2, np.float32), rng, 8))
    for one, hidden in ((even, nothing(even)), (blurred, ~nothing(blurred))):
        assert "edges between even surfaces" in sharpness(one, hidden).overshoot.text()


@pytest.mark.parametrize(("amount", "radius"), [(0.8, 0.7), (2.45, 1.4), (1.0, 3.0)])
def test_sharpening_multiplies_noise_as_stated(amount, radius):
    noisy = np.clip(np.random.default_rng(14).normal(128, 3, (300, 300, 3)), 0, 255).astype(np.uint8)
    measured = processed(noisy[None], amount, radius).var() / noisy.var()
    assert Sharpness(exact(9.0), amount, radius).noise_gain == pytest.approx(measured, rel=0.05)
    assert Sharpness(exact(0.0)).noise_gain == 1


RUST = (110, 60, 35)


@pytest.mark.parametrize(("paint", "hue"), [((40, 84, 140), 214), ((200, 160, 20), 47), ((40, 120, 60), 135)])
def test_the_hue_of_paint_under_rust_is_found(paint, hue):
    rng = np.random.default_rng(8)
    grab = np.full((200, 200, 3), RUST, np.uint8)
    grab[np.kron(rng.random((20, 20)) < 0.3, np.ones((10, 10), bool))] = paint
    grab[:60] = (120, 120, 118)  # bare steel
    smeared = cv2.GaussianBlur(grab, (3, 3), 0)
    boxes = [(smeared, np.array([0.0, 0.0, 200.0, 200.0]))] * 3
    found, rgb = _paint(footage(np.stack([smeared] * 3)), boxes)
    assert found.low < hue < found.high
    assert found.high - found.low < 50
    np.testing.assert_allclose(np.array(rgb) * 255, paint, atol=15)


def test_a_grab_of_many_colours_has_none():
    colours = [(40, 84, 200), (40, 200, 60), (200, 40, 200)] * 3
    frames = np.stack([np.full((60, 60, 3), colour, np.uint8) for colour in colours])
    boxes = [(frame, np.array([0.0, 0.0, 60.0, 60.0])) for frame in frames]
    found, rgb = _paint(footage(frames), boxes)
    assert "differ too much" in found.text()
    assert rgb is None
    rusty = [(np.full((60, 60, 3), RUST, np.uint8), boxes[0][1])] * 9
    assert not _paint(footage(frames), [boxes[0], *rusty])[0].known  # one blue frame among nine of rust


def test_paint_is_as_bright_under_any_exposure():
    light = decoded(np.array([0.2, 0.4, 0.6]))
    for stops in (-3.0, 0.0, 1.0):
        np.testing.assert_allclose(matching._paint(encoded(light * 2**stops), stops), [0.2, 0.4, 0.6], atol=1e-9)
    assert max(matching._paint((0.2, 0.4, 0.6), -6.0)) <= 1.0


def test_a_scene_to_train_on_varies_what_was_measured_within_its_interval(tmp_path):
    rng = np.random.default_rng(9)
    seen = measure(read(video(tmp_path / "seen.mp4", taken(scene(rng, 3.0, 1.0), rng))), detector())
    found = Grab(exact(1.0), exact(80.0, "px"), exact(214.0, "°"), (0.1, 0.2, 0.4), np.zeros((0, 4)))
    matched = scenes.load("quay-day", {"grab.paint_rgb": [0.2, 0.3, 0.6]})
    path = tmp_path / "training.toml"
    path.write_text(matching.training_scene(replace(seen, grab=found), matched), encoding="utf-8")
    drawn = [one.scenario for one, _ in variants(scenes.load(path, {"frames": 96}))]
    assert len({one.place for one in drawn}) > 3
    assert {one.grab.paint_rgb for one in drawn} == {matched.grab.paint_rgb}
    assert {(one.camera.width_px, one.camera.height_px) for one in drawn} == {seen.footage.size}
    for values, quantity in (
        ([one.optics.defocus_px for one in drawn], seen.blur),
        ([one.optics.vignetting_stops for one in drawn], seen.vignetting),
    ):
        assert quantity.known
        assert quantity.low <= min(values) < max(values) <= quantity.high
    wells = [one.optics.sensor.full_well_e for one in drawn]
    assert wells == pytest.approx([1 / seen.noise.gain.value] * len(drawn), rel=1e-3)


def test_a_scene_to_train_on_fits_portraits_and_any_blur(tmp_path):
    rng = np.random.default_rng(10)
    seen = measure(read(video(tmp_path / "seen.mp4", taken(scene(rng), rng, 2).transpose(0, 2, 1, 3))), detector())
    assert seen.footage.size[0] < seen.footage.size[1]
    seen = replace(seen, blur=Quantity(40.0, 10.0, 70.0, unit="px"))
    matching.Matched(seen, "", matching.training_scene(seen, scenes.load()), None).save(tmp_path)
    training = scenes.load(tmp_path / matching.TRAINING)
    assert training.vary["optics.defocus_px"] == Uniform(10.0, matching.MOST_BLUR_PX)
    text = (tmp_path / matching.TRAINING).read_text()
    assert "# The focal length varies" in text
    assert "paper" not in text


def test_what_is_recorded_at_night_is_matched_by_a_scene_at_night(tmp_path, monkeypatch):
    monkeypatch.setattr(matching, "_exposure", lambda _data, _seen: (0.0, []))  # which renders
    rng = np.random.default_rng(11)
    footage_at_night = read(video(tmp_path / "night.mp4", taken(scene(rng, 0.0, 1.0), rng, 8)))
    seen = measure(footage_at_night, detector(), night=True)
    assert "floodlights" in seen.vignetting.text()
    assert measure(footage_at_night, detector()).vignetting.known
    matched, _ = matching.scene_of(seen, night=True)
    assert matched.light.sun == 0
    assert matched.light.floodlights > 0
    path = tmp_path / "training.toml"
    path.write_text(matching.training_scene(seen, matched), encoding="utf-8")
    drawn = [one.scenario for one, _ in variants(scenes.load(path, {"frames": 80}))]
    assert {one.light.sun for one in drawn} == {0.0}
    assert len({one.weather for one in drawn}) > 2


def test_numbers_are_found_where_clutter_joins_or_adds_characters_and_a_clock_is_broken():
    clock = [(x, 13.0, x + 6.0, 23.0) for x in (81.0, 91.0, 104.0, 114.0, 187.0, 195.0, 214.0, 222.0)]
    joined = [(584.5, 33.0, 591.0, 43.0), (594.0, 33.0, 601.0, 43.0), (605.0, 33.0, 611.5, 43.0)]
    hoist = [*joined, (616.0, 33.0, 627.5, 43.0)]  # the last one with something beside it
    closing = [(x0, y0 + 18, min(x1, 623.0), y1 + 18) for x0, y0, x1, y1 in hoist]
    added = (600.0, 52.0, 607.0, 61.0)  # across two digits
    for boxes in ([*clock, *hoist, *closing, added], [*clock, *hoist, *closing[:1], added, *closing[1:]]):
        above, below = _pairs(_lines(boxes), 640)[0]
        assert (list(above), list(below)) == (hoist, closing)


def test_a_camera_file_for_run_names_what_footage_does_not_determine(tmp_path):
    rng = np.random.default_rng(5)
    seen = measure(read(video(tmp_path / "one.mp4", taken(scene(rng), rng, 1))), detector())
    layout = layouts.load("two-by-four").scaled(*SIZE)
    for shown_digits, constant in ((seen.display, set()), (DisplayMatch(layout, "", 1.0), {"display_constant_m"})):
        file = tmp_path / "camera.toml"
        file.write_text(matching.camera_of(replace(seen, display=shown_digits)))
        camera = calibration.load(file)
        assert (camera.width_px, camera.height_px, camera.digit_layout) == (*SIZE, shown_digits.layout)
        assert {*camera.assumed} == {"focal_length_px", "cx_px", "cy_px", "k1", "offset_m", "roll_deg"} | constant
        assert "focal_length_px: not determined by footage" in file.read_text()
        assert "on the right where the second number is above 0" in file.read_text()
    file.write_text(file.read_text().replace('"cx_px"', '"cx"'))
    with pytest.raises(CalibrationError, match=r"camera\.toml: .*there is no 'cx'"):
        calibration.load(file)


def test_footage_without_a_display_has_none():
    rng = np.random.default_rng(4)
    assert display(footage(taken(scene(rng), rng, 8))).layout is None


def video(path: Path, frames: np.ndarray, state: Callable[[av.VideoStream], None] | None = None) -> Path:
    """Code frames without loss of luma."""
    times, lossless = np.arange(len(frames)) / 10, {"qp": "0", "preset": "ultrafast", "g": "250"}
    return film(path, times, frames.shape[2:0:-1], draw=lambda i, _: frames[i], coding=lossless, state=state)


def test_footage_is_what_players_show(tmp_path):
    frames = taken(scene(np.random.default_rng(3)), np.random.default_rng(4), 2)
    plain = read(video(tmp_path / "plain.mp4", frames))

    def state(stream):
        stream.set_display_rotation(90)
        stream.codec_context.sample_aspect_ratio = Fraction(3, 2)

    shown = read(video(tmp_path / "shown.mp4", frames, state))
    width, height = SIZE
    assert shown.size == (height, width * 3 // 2)
    wide = cv2.resize(plain.luma[1], (width * 3 // 2, height), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_array_equal(shown.luma[1], np.rot90(wide))
    assert shown.rgb.shape[1:3] == shown.luma.shape[1:]
    assert "are made square" in shown.note
    assert "turned by 90°" in shown.note
    assert not plain.note
    assert plain.frame_rate_hz == shown.frame_rate_hz


def test_a_black_video_determines_nothing_but_what_its_file_states(tmp_path):
    seen = measure(read(video(tmp_path / "black.mp4", np.zeros((10, 96, 128, 3), np.uint8))), detector())
    assert seen.dark
    determined = {name for name, text in seen.rows() if not text.startswith("not determined")}
    assert determined == {
        "size", "coder", "frame rate", "bit rate", "quantiser step", "grey picture", "share of frames with a grab",
    }  # fmt: skip


def test_the_blue_of_a_camera_without_signal_determines_no_cast():
    seen = measure(footage(np.full((8, 96, 128, 3), (0, 0, 200), np.uint8)), detector())
    assert "no green" in seen.cast[0].text()
    assert seen.level.known


def test_one_frame_determines_neither_noise_nor_rate(tmp_path):
    rng = np.random.default_rng(5)
    seen = measure(read(video(tmp_path / "one.mp4", taken(scene(rng), rng, 1))), detector())
    assert not seen.noise.gain.known
    assert "too few frames" in seen.noise.gain.text()
    assert not seen.grab.size_px.known
    assert seen.display.layout is None


@needs_chromium
def test_the_page_shows_both_and_fits_a_phone(tmp_path):
    rng = np.random.default_rng(6)
    theirs, ours = (
        measure(read(video(tmp_path / f"{name}.mp4", taken(scene(rng), rng))), detector()) for name in ("<b>x", "ours")
    )
    text = matching.page(matching.Matched(theirs, f"# {theirs.footage.name} {'x' * 300}", "", ours))
    assert "<b>x" not in text
    assert len(shown(text, tmp_path)["figures"]) == 5  # two frames, histogram, spectrum, noise


@pytest.mark.parametrize("content", [b"", b"hello" * 100, None])
def test_what_is_no_video_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "broken.mp4"
    if content is None:
        whole = video(path, np.zeros((10, 96, 128, 3), np.uint8)).read_bytes()
        content = whole[: len(whole) // 3]
    path.write_bytes(content)
    with pytest.raises(SourceError) as refused:
        read(path)
    assert "\n" not in str(refused.value)
