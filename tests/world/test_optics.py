"""Each effect is measured in the picture and compared with what physics says; each is off at zero."""

import itertools
import math

import cv2
import msgspec
import numpy as np
import pytest
from scipy import stats
from test_row_blocks import by_threads

from simgrab.model.geometry import Distortion, Intrinsics
from simgrab.model.rng import stream
from simgrab.model.scenario import AutoExposure, FixedExposure, Optics, Sensor, Sharpening
from simgrab.world.camera.optics import Exposure, expose, metered, recompress, to_display, to_linear
from simgrab.world.camera.optics.exposure import HYSTERESIS_DB
from simgrab.world.camera.optics.focus import defocus
from simgrab.world.camera.optics.light import BT709
from simgrab.world.camera.optics.sensor import normals

WIDTH, HEIGHT = 480, 270
PLAIN = Intrinsics(WIDTH, HEIGHT, 411.2, WIDTH / 2, HEIGHT / 2)
CROOKED = Intrinsics(WIDTH, HEIGHT, 411.2, 252.5, 127.0, Distortion(-0.28, 0.09, 5e-4, -8e-4, -0.01))
NEUTRAL, GREY = Exposure(0.0, False), Exposure(0.0, True)
NOISY = Optics(sensor=Sensor(full_well_e=1000, read_noise_e=20))
# Everything at once.
NIGHT = Optics(
    vignetting_stops=1.5, defocus_px=2.5, chromatic_px=1.5, exposure=AutoExposure(), night_mode="auto",
    sensor=Sensor(full_well_e=6000, read_noise_e=4, fixed_pattern_percent=1), recompress_quality=40,
)  # fmt: skip


def flat(level, width=WIDTH, height=HEIGHT):
    return np.full((height, width, 3), level, np.float32)


def scene(seed=0, width=WIDTH, height=HEIGHT):
    """Something with edges, colours and gradients."""
    coarse = np.random.default_rng(seed).integers(0, 256, (height // 30, width // 30, 3), dtype=np.uint8)
    rgb = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return to_linear(cv2.addWeighted(rgb, 0.7, cv2.resize(coarse, (width, height)), 0.3, 0))


def take(optics, light, *, intrinsics=PLAIN, seed=0, frame=0, exposure=NEUTRAL):
    return expose(optics, light, intrinsics=intrinsics, seed=seed, frame=frame, exposure=exposure)


def test_the_transfer_is_srgb_and_gives_back_every_value():
    values = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    assert (to_display(to_linear(values)) == values).all()
    # IEC 61966-2-1: both branches, and where they meet.
    assert to_linear(values).ravel()[[0, 3 * 10, 3 * 188, -1]] == pytest.approx([0, 10 / 255 / 12.92, 0.50289, 1], 1e-4)
    assert to_display(flat(2.0)).min() == 255
    assert to_display(flat(-1.0)).max() == 0


def test_all_effects_off_leave_every_byte():
    light = scene()
    assert Optics().off
    assert Optics(sharpening=Sharpening(radius_px=0.3)).off
    assert (take(Optics(), light, intrinsics=CROOKED) == to_display(light)).all()
    assert (recompress(to_display(light), 0) == to_display(light)).all()
    assert (defocus(light, 1.0) == light).all()  # up to a pixel there is none
    assert metered(Optics(), light) == NEUTRAL
    every = {
        name: getattr(NIGHT, name) for name in ("vignetting_stops", "defocus_px", "chromatic_px", "exposure", "sensor")
    }
    every |= {"night_mode": "on", "recompress_quality": 40, "white_balance": (1.2, 1.0, 0.8)}
    assert not any(Optics(**{name: value}).off for name, value in every.items())
    assert not Optics(sharpening=Sharpening(amount=1.0)).off


def test_light_is_left_alone_and_a_frame_can_be_taken_again():
    light = scene()
    light.flags.writeable = False
    exposure = metered(NIGHT, light)
    first = take(NIGHT, light, exposure=exposure, frame=7)
    assert (first == take(NIGHT, light, exposure=exposure, frame=7)).all()


def test_noise_differs_between_frames_and_seeds():
    pictures = [take(NOISY, flat(0.3), seed=s, frame=f).astype(float) for s, f in ((0, 0), (0, 1), (1, 0))]
    for a, b in itertools.combinations(pictures, 2):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 5 / math.sqrt(a.size)


@pytest.mark.parametrize("defocus_px", [2.5, 20.0])  # small kernels are summed, large ones go through a DFT
@pytest.mark.parametrize("grey", [False, True])
def test_bytes_do_not_depend_on_the_number_of_threads(defocus_px, grey):
    light, optics = scene(width=640, height=360), Optics(1.5, defocus_px, 1.5, sensor=NIGHT.sensor)
    k, exposure = Intrinsics(640, 360, 548.0, 330.0, 170.0), Exposure(math.log2(3.0), grey)
    pictures = by_threads(lambda: recompress(take(optics, light, intrinsics=k, exposure=exposure), 40).tobytes())
    assert len(set(pictures)) == 1


@pytest.mark.parametrize("intrinsics", [PLAIN, CROOKED], ids=["plain", "crooked"])
def test_natural_vignetting_is_cos4_of_the_rays_angle(intrinsics):
    corners = intrinsics.rays([(x, y) for x in (0, WIDTH) for y in (0, HEIGHT)])[:, 2]
    optics = Optics(vignetting_stops=4 * math.log2(1 / corners.min()))
    seen = to_linear(take(optics, flat(0.9), intrinsics=intrinsics))[..., 1]
    rows, columns = np.mgrid[0:HEIGHT:9, 0:WIDTH:9]
    cosine = intrinsics.rays(np.stack([columns, rows], -1) + 0.5)[..., 2]
    assert seen[rows, columns] / 0.9 == pytest.approx(cosine**4, abs=0.005)  # half an 8-bit step is 0.004 of white


@pytest.mark.parametrize("stops", [0.5, 2.0])
def test_the_farthest_corner_loses_the_stops_that_were_asked_for(stops):
    seen = to_linear(take(Optics(vignetting_stops=stops), flat(0.9), intrinsics=CROOKED))[..., 0]
    corners = seen[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert math.log2(0.9 / corners.min()) == pytest.approx(stops, abs=0.03)
    assert seen[127, 252] == pytest.approx(0.9, abs=0.004)  # the principal point loses nothing


@pytest.mark.parametrize("diameter_px", [3.0, 6.5, 12.0, 24.0])
def test_a_defocused_point_is_a_disc_of_the_diameter_that_was_asked_for(diameter_px):
    light = np.zeros((81, 81, 3), np.float32)
    light[40, 40] = 1000.0
    spread = defocus(light, diameter_px)[..., 1].astype(float)
    assert spread.sum() == pytest.approx(1000, rel=1e-4)
    assert spread.min() >= 0
    at = np.arange(81) - 40
    for axis in (0, 1):  # a disc's second moment, and that of the pixels it is gathered in
        moment = (spread.sum(axis) * at**2).sum() / spread.sum()
        assert moment == pytest.approx(diameter_px**2 / 16 + 1 / 12, abs=0.07)  # aliasing
    reach = np.hypot(at, at[:, None])
    assert spread[reach > diameter_px / 2 + 0.75].max() < 1e-3
    inside = spread[reach < diameter_px / 2 - 0.75]
    assert np.ptp(inside) < 0.01 * inside.mean()


def test_chromatic_aberration_grows_with_the_radius():
    rng = np.random.default_rng(4)
    light, centre = np.zeros((HEIGHT, WIDTH, 3), np.float32), np.array([CROOKED.cx_px, CROOKED.cy_px])
    dots = [(x, y) for x in range(20, WIDTH - 20, 40) for y in range(20, HEIGHT - 20, 40)]
    for x, y in dots:
        light[y - 3 : y + 4, x - 3 : x + 4] = rng.uniform(0.5, 1.0)
    seen = to_linear(take(Optics(chromatic_px=3.0), light, intrinsics=CROOKED))
    reach = max(math.dist(centre, c) for c in itertools.product((0.5, WIDTH - 0.5), (0.5, HEIGHT - 0.5)))
    grid = np.stack(np.meshgrid(np.arange(-10, 11), np.arange(-10, 11)), -1)
    for x, y in dots:
        window = seen[y - 10 : y + 11, x - 10 : x + 11]
        moved = [np.average(grid.reshape(-1, 2), axis=0, weights=window[..., c].ravel()) for c in range(3)]
        expected = 3.0 / reach * (np.array([x, y]) + 0.5 - centre)
        assert moved[0] == pytest.approx(expected, abs=0.06)
        assert moved[1] == pytest.approx((0, 0), abs=1e-6)
        assert moved[2] == pytest.approx(-expected, abs=0.06)


@pytest.mark.parametrize("ev", [-2.0, 1.0, 1.5])
def test_a_stop_doubles_the_light(ev):
    optics = Optics(exposure=FixedExposure(exposure_ev=ev))
    seen = to_linear(take(optics, flat(0.2), exposure=metered(optics, flat(0.2))))
    assert seen.mean() == pytest.approx(0.2 * 2**ev, rel=0.01)


@pytest.mark.parametrize("light_level", [0.1, 0.9])
@pytest.mark.parametrize("ev", [0.0, -1.0])
def test_automatic_exposure_brings_the_mean_to_its_target(light_level, ev):
    optics = Optics(exposure=AutoExposure(exposure_ev=ev, target_level=0.2))
    light = scene() * np.float32(light_level) * np.array([0.1, 0.5, 1.0], np.float32)
    exposure = metered(optics, light)
    wanted = 0.2 * 2.0**ev
    assert exposure.gain * (light @ BT709).mean() == pytest.approx(wanted, rel=0.02)
    assert to_linear(take(optics, flat(0.1), exposure=metered(optics, flat(0.1)))).mean() == pytest.approx(wanted, 0.01)
    bound = Optics(exposure=AutoExposure(max_gain_db=20.0))
    assert [metered(bound, flat(dark)).gain for dark in (1e-4, 0.0)] == pytest.approx([10, 10])


def exposures(optics, rate, lights):
    """Exposures of a clip's frames in order."""
    before = None
    for light in lights:
        before = metered(optics, light, before, period_s=1 / rate)
        yield before


@pytest.mark.parametrize("rate", [5.0, 25.0])
def test_the_exposure_lags_by_its_time_constant(rate):
    optics = Optics(exposure=AutoExposure(target_level=0.2, lag_s=2.0))
    lights = [flat(0.2)] + [flat(0.05)] * round(2 * rate)
    first, *gains = (exposure.gain for exposure in exposures(optics, rate, lights))
    assert first == pytest.approx(1)  # settled when a clip begins
    assert math.log2(gains[-1]) / 2 == pytest.approx(1 - math.exp(-1))  # of the two stops, after one time constant
    assert all(a < b for a, b in itertools.pairwise(gains))
    prompt = Optics(exposure=AutoExposure(lag_s=0.0))
    assert list(exposures(prompt, rate, lights[:2])) == [metered(prompt, light) for light in lights[:2]]


def photon_transfer(optics, gain, *, grey=False):
    """Level and variance over time of pictures of even grey surfaces."""
    means, variances = [], []
    for level in (0.2, 0.3, 0.4, 0.5):
        exposure = Exposure(math.log2(gain), grey)
        a, b = (to_linear(take(optics, flat(level / gain), frame=f, exposure=exposure)).astype(float) for f in (0, 1))
        a, b = (a[..., :1], b[..., :1]) if grey else (a, b)  # the three are one
        means.append((a.mean() + b.mean()) / 2)
        variances.append(((a - b) ** 2).mean() / 2)  # the fixed pattern goes out
    return np.array(means), np.array(variances)


@pytest.mark.parametrize(("gain", "well", "read"), [(1.0, 1000, 20.0), (4.0, 8000, 60.0), (0.25, 1000, 20.0)])
@pytest.mark.parametrize("grey", [False, True])
def test_variance_is_the_straight_line_of_a_photon_transfer_curve(gain, well, read, grey):
    optics = Optics(sensor=Sensor(full_well_e=well, read_noise_e=read, fixed_pattern_percent=2))
    amplification = max(gain, 1)  # an iris keeps light out and amplifies nothing
    level, variance = photon_transfer(optics, gain, grey=grey)
    expected = amplification / well * level + (amplification * read / well) ** 2
    assert variance == pytest.approx(expected, rel=0.03 if grey else 0.02)
    slope, intercept = np.polyfit(level, variance, 1)
    assert slope == pytest.approx(amplification / well, rel=0.15 if grey else 0.08)
    assert intercept == pytest.approx((amplification * read / well) ** 2, abs=0.05 * variance[0])


def test_noise_is_normal():
    noise = normals((600, 800, 3), stream(3, 14, "optics.noise")).astype(float)
    count = noise.size
    assert noise.mean() == pytest.approx(0, abs=4 / math.sqrt(count))
    assert noise.var() == pytest.approx(1, abs=4 * math.sqrt(2 / count))
    assert stats.kurtosis(noise, axis=None) == pytest.approx(0, abs=4 * math.sqrt(24 / count))
    assert stats.kstest(noise.ravel()[::7], "norm").pvalue > 1e-3


def test_noise_in_the_picture_is_white_and_its_channels_apart():
    k = Intrinsics(960, 540, 822.4, 480.0, 270.0)
    noise = take(NOISY, flat(0.3, 960, 540), intrinsics=k).astype(float)
    noise = (noise - noise.mean()) / noise.std()
    channels = np.corrcoef(noise.reshape(-1, 3), rowvar=False)
    assert np.abs(channels - np.eye(3)).max() < 0.01
    power = np.abs(np.fft.rfft2(noise, axes=(0, 1))) ** 2
    correlation = np.fft.irfft2(power, (540, 960), axes=(0, 1)) / (540 * 960)
    correlation[0, 0] = 0
    assert np.abs(correlation).max() < 0.01  # at every shift: repetition would show


def test_the_fixed_pattern_stays_and_is_the_cameras_own():
    optics = Optics(sensor=Sensor(fixed_pattern_percent=5))
    pictures = [to_linear(take(optics, flat(0.4), seed=s, frame=f)).astype(float) for s, f in ((0, 0), (0, 9), (1, 0))]
    assert (pictures[0] == pictures[1]).all()
    assert abs(np.corrcoef(pictures[0].ravel(), pictures[2].ravel())[0, 1]) < 0.01
    assert pictures[0].std() / pictures[0].mean() == pytest.approx(0.05, rel=0.01)
    doubled = to_linear(take(optics, flat(0.2), exposure=Exposure(1.0, False)))
    assert (doubled == pictures[0]).all()  # it multiplies light


def test_grey_is_the_luminance_of_bt709():
    light = scene()
    seen = take(Optics(night_mode="on"), light, exposure=Exposure(0.0, True))
    assert (np.ptp(seen, axis=2) == 0).all()
    assert to_linear(seen)[..., 0] == pytest.approx(light @ BT709, abs=0.005)
    assert metered(Optics(night_mode="on"), light).grey
    assert not metered(Optics(night_mode="off", exposure=AutoExposure()), flat(1e-4)).grey


def test_white_balance_multiplies_light_and_leaves_grey_alone():
    light = flat(0.2)
    cast = Optics(white_balance=(1.5, 1.0, 0.5))
    np.testing.assert_array_equal(take(cast, light), to_display(light * np.array([1.5, 1.0, 0.5], np.float32)))
    grey = msgspec.structs.replace(cast, night_mode="on")
    plain = msgspec.structs.replace(grey, white_balance=(1.0, 1.0, 1.0))
    assert (take(grey, light, exposure=GREY) == take(plain, light, exposure=GREY)).all()


@pytest.mark.parametrize(("amount", "radius"), [(0.5, 0.8), (1.0, 1.5), (2.2, 3.0)])
def test_sharpening_overshoots_an_edge_as_an_unsharp_mask_does(amount, radius):
    values = flat(90.0)
    values[:, WIDTH // 2 :] = 150.0
    light = to_linear(values.astype(np.uint8))
    seen = take(Optics(sharpening=Sharpening(amount=amount, radius_px=radius)), light)[HEIGHT // 2, :, 1].astype(float)
    across = np.arange(WIDTH) + 0.5 - WIDTH / 2
    blurred = 90 + 60 * stats.norm.cdf(across / radius)
    np.testing.assert_allclose(seen, values[0, :, 1] + amount * (values[0, :, 1] - blurred), atol=2.5)


def test_night_begins_at_its_gain_and_ends_well_below():
    auto = AutoExposure(target_level=0.2, night_gain_db=18.0, lag_s=0.0)
    gains_db = (17.9, 18.1, 17.9, 18.1 - HYSTERESIS_DB, 17.9 - HYSTERESIS_DB, 17.9)
    lights = [flat(0.2 * 10 ** (-db / 20)) for db in gains_db]
    seen = [exposure.grey for exposure in exposures(Optics(exposure=auto, night_mode="auto"), 25.0, lights)]
    assert seen == [False, True, True, True, False, False]


def test_artefacts_grow_as_the_quality_falls():
    rgb = take(NOISY, scene())
    psnr = [cv2.PSNR(rgb, recompress(rgb, quality)) for quality in (10, 30, 50, 70, 90, 100)]
    assert all(b - a > 0.3 for a, b in itertools.pairwise(psnr))
    assert psnr[0] < 30
    assert recompress(rgb, 10).shape == rgb.shape


def test_coding_keeps_colours_in_their_channels_and_grey_grey():
    red = np.full((32, 32, 3), (200, 0, 0), np.uint8)
    assert recompress(red, 80)[16, 16] == pytest.approx((200, 0, 0), abs=6)
    grey = recompress(take(NOISY, scene(), exposure=GREY), 30)
    assert np.ptp(grey.astype(int), axis=2).max() <= 1
