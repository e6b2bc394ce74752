"""The mistake that explains angles is named, and none is where the angles are right."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simgrab.judge.check import suite
from simgrab.judge.check.mistakes import likely, of_centres, of_rope
from simgrab.model import scenes
from simgrab.model.geometry import Pose, camera_rotation, on_ropes, swing_of
from simgrab.world.extensions import Recipe
from simgrab.world.trajectory.trajectory import Trajectory

SCENES = [(name, scene) for name in suite.names() for scene in suite.load(name).scenes]
FRAMES = 48
WRONG_TILT = re.compile(r"The angles are as with a camera tilt that is (2\.[5-9]|3\.[0-4])\d° wrong.*")


def truth(name, scene, frames=FRAMES):
    """Rows of a suite's scene, of which every fourth frame is taken, and the true swing, rad, shape (n,)."""
    return rows_of(suite.load(name).scenario(scene), frames)


def rows_of(scenario, frames=FRAMES):
    recipe, rows, moves, number = Recipe(scenario), [], None, None
    for frame in range(0, min(scenario.frames, 4 * frames), 4 if scenario.frames >= 4 * frames else 1):
        if number != recipe.variant_number(frame):
            number, variant = recipe.variant_number(frame), recipe.variant(frame)
            moves = Trajectory(variant.scenario, recipe.extensions)
        moment, camera = moves.at(frame), variant.scenario.camera
        k = camera.intrinsics
        in_camera = Pose(moment.tilt.jib_from_camera, np.asarray(camera.offset_m)).local(
            moment.grab.jib_from_grab.translation
        )
        rows.append(SimpleNamespace(
            alpha=moment.grab.alpha, fx_px=k.f_px, cx_px=k.cx_px, cy_px=k.cy_px, k1=k.distortion.k1, k2=k.distortion.k2,
            **dict(zip(("grab_u_px", "grab_v_px"), k.project(in_camera[None])[0], strict=True)),
            ideal_u_px=k.cx_px + k.f_px * in_camera[0] / in_camera[2],
            ideal_v_px=k.cy_px + k.f_px * in_camera[1] / in_camera[2],
            jib_from_grab=np.asarray(moment.grab.jib_from_grab)[:3].ravel(),
            jib_from_camera=np.column_stack([moment.tilt.jib_from_camera, camera.offset_m]).ravel(),
            roll_deg=np.degrees(moment.tilt.roll),
        ))  # fmt: skip
    return rows, np.array([row.alpha for row in rows])


def places(rows, of):
    """Places (n, 3) of the grab or the camera."""
    return np.reshape([getattr(row, f"jib_from_{of}") for row in rows], (-1, 3, 4))[..., 3].copy()


def ropes(rows):
    return np.linalg.norm(places(rows, "grab"), axis=1, keepdims=True)


def named(measured, true, rows, noise_deg=0.0, **known):
    """Name the mistake of angles with noise."""
    noise = np.random.default_rng(0).normal(0, np.deg2rad(noise_deg), len(true))
    return likely(measured + noise, true, rows, None, **known).text


def leaning(rows, by=0.0, lean=(0.0, 0.0), shift=0.0):
    """Swings of a pipeline that errs.

    Its directions are moved by vectors (n, 2), its tilt is wrong by (2,), rad, its offset by (n, 2), in rope lengths.
    """
    grab, camera, length = places(rows, "grab"), places(rows, "camera"), ropes(rows)
    level = (grab / length)[:, :2] + by
    found = length * np.column_stack([level, -np.sqrt(1 - np.sum(level**2, axis=1))])
    turn = Rotation.from_rotvec([lean[1], -lean[0], 0.0])  # of the rays, about the camera, for ropes of the same length
    ray = turn.apply(found - camera)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    camera[:, :2] += shift * length
    along = np.sum(ray * camera, axis=1, keepdims=True)
    reach = np.sqrt(along**2 + length**2 - np.sum(camera**2, axis=1, keepdims=True)) - along
    return np.arccos(-((camera + reach * ray) / length)[:, 2])


def tilt_of(rows):
    """Tilt of a camera that does not turn, (2,), rad."""
    axis = np.mean([np.reshape(row.jib_from_camera, (3, 4))[:2, 2] for row in rows], axis=0)
    return axis / np.linalg.norm(axis) * np.arcsin(np.linalg.norm(axis))


@pytest.mark.parametrize(("name", "scene"), SCENES)
def test_no_mistake_is_named_where_there_is_none(name, scene):
    rows, true = truth(name, scene)
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0, np.deg2rad(0.3), len(true))
        for measured in (true, true + np.deg2rad(0.4)):
            assert likely(np.abs(measured + noise), true, rows, None) is None
        for deg in (3.0, -3.0):
            found = likely(np.abs(leaning(rows, lean=[np.deg2rad(deg), 0]) + noise), true, rows, None)
            assert found is None or WRONG_TILT.fullmatch(found.text)
    lengths = np.random.default_rng(0).normal(20, 4, FRAMES)
    assert of_rope(lengths + np.random.default_rng(1).normal(0, 0.1, FRAMES), lengths) is None
    assert of_rope(lengths, lengths) is None


def test_a_tilt_that_is_left_out_or_wrong_is_named():
    rows, true = truth("weather", "calm")
    axis = tilt_of(rows)
    deg = np.rad2deg(np.linalg.norm(axis))
    for lean, text in (
        (-axis, f"is {deg:.2f}° wrong, as if the tilt of {deg:.1f}° were left out"),
        (
            -2 * axis,
            f"is {2 * deg:.2f}° wrong, as if the tilt of {deg:.1f}° had the opposite sign, or if top and bottom of the "
            "image were exchanged",
        ),
        (0.5 * axis, f"is {deg / 2:.2f}° wrong, {1.5 * deg:.1f}° with an azimuth of 0° in place of {deg:.1f}° with 0°"),
    ):
        assert named(leaning(rows, lean=lean), true, rows) == f"The angles are as with a camera tilt that {text}"


def test_a_tilt_that_is_far_off_is_named_beside_a_focal_length():
    """A wrong focal length and a large tilt together leave less, and no estimated tilt follows from one."""
    changes = {"swing.start": {"alpha_deg": 12.0}, "camera.beta_deg": 6.0, "camera.tilt_azimuth_deg": 0.0}
    rows, true = rows_of(scenes.load("free-swing", changes))
    axis = np.reshape([row.jib_from_camera for row in rows], (-1, 3, 4))[:, :2, 2]
    ray = places(rows, "grab") - places(rows, "camera")
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    text = named(leaning(rows, -0.03 * (ray[:, :2] - axis), -2 * tilt_of(rows)), true, rows)
    beside = r"of 1\d+ px \(.*\), and with a camera tilt that is 1[12]\.\d\d° wrong, as if .* had the opposite"
    assert re.search(beside, text)
    other = likely(leaning(rows, -0.2 * (ray[:, :2] - axis), np.radians([0.0, 10.0])), true, rows, None)
    assert other is None or "and with a camera tilt" not in other.text  # no mount is that far off in no usual way


@pytest.mark.parametrize(("factor", "what"), [(0.0, "left out"), (-1.0, "applied with the opposite sign")])
@pytest.mark.parametrize("follows", [False, True])
def test_an_offset_that_is_left_out_or_mirrored_is_named(follows, factor, what):
    rows, true = truth("offset", "beside")
    offset = places(rows, "camera")[:, :2]
    by = (factor - 1) * offset / ropes(rows)
    lean = -by.mean(axis=0) if follows else np.zeros(2)  # of the tilt that is estimated from the same record
    across = np.linalg.norm(offset[0])
    alike = ", or if left and right of the image were exchanged" * (factor < 0 and not follows)
    assert named(leaning(rows, lean=lean, shift=by), true, rows, 0.05) == (
        f"The angles are as if the camera's horizontal offset of {across:.2f} m were {what}{alike}"
    )


@pytest.mark.parametrize(
    ("azimuth", "also"), [(0.0, ""), (90.0, "if the camera's horizontal offset of 0.60 m were left out")]
)
def test_on_a_rope_of_constant_length_an_offset_and_a_tilt_along_it_look_alike(azimuth, also):
    changes = {"camera.tilt_azimuth_deg": azimuth, "camera.beta_deg": np.degrees(0.6 / 18), "frames": 192}
    rows, true = rows_of(scenes.load("free-swing", changes))
    text = named(leaning(rows, lean=-tilt_of(rows)), true, rows, 0.03)
    assert "with a camera tilt that is 1.9" in text
    assert "as if the tilt of 1.9° were left out" in text
    assert (also and f"The angles are as {also}, or with a camera tilt" in text) or not also


@pytest.mark.parametrize(
    ("used", "rope_known", "text"),
    [
        ((0.9, 0.5), False, "if x and y of the camera's offset were exchanged"),
        ((0.7, 0.9), False, "with a horizontal camera offset of (0.70, 0.90) m in place of (0.50, 0.90) m"),
        ((0.4, 0.72), True, "with 0.80 times the camera's horizontal offset of 1.03 m"),
        (
            (0.125, 0.225),
            False,
            "with rope lengths that are 4 times the true ones, or with 0.25 times the camera's horizontal offset of "
            "1.03 m",
        ),
    ],
)
@pytest.mark.parametrize("follows", [False, True])
def test_an_offset_that_is_wrong_otherwise_is_named(follows, used, rope_known, text):
    """Rope lengths that are not output look like a share of the offset."""
    rows, true = rows_of(scenes.load("quay-day", {"camera.offset_x_m": 0.5, "camera.offset_y_m": 0.9, "frames": 32}))
    by = (np.array(used) - [0.5, 0.9]) / ropes(rows)
    measured = leaning(rows, lean=-by.mean(axis=0) if follows else np.zeros(2), shift=by)
    tilt = ", and the tilt that is estimated with it" * (follows and "in place of" in text)
    assert named(measured, true, rows, 0.005, rope_known=rope_known) == f"The angles are as {text}{tilt}"


def test_an_offset_on_ropes_of_similar_lengths_is_named():
    changes = {"camera.offset_x_m": 0.4, "camera.offset_y_m": 0.7, "frames": FRAMES}
    rope = {"dist": "uniform", "low": 9.0, "high": 13.4}
    rows, true = rows_of(scenes.load("quay-day", changes | {"swing.rope_length_m": rope}))
    text = named(leaning(rows, shift=[0, -0.25] / ropes(rows)), true, rows, 0.05)
    assert re.search(r"offset of \(0\.(39|40|41), 0\.4\d\) m in place of \(0\.40, 0\.70\) m$", text)


@pytest.mark.parametrize(
    ("roll", "used", "text"),
    [
        (10.0, -10.0, "if the camera's roll of 10.0° were applied with the opposite sign"),
        (10.0, 0.0, "if the camera's roll of 10.0° were left out"),
        (10.0, 55.0, r"with a camera roll of 5[45]\.\d° in place of 10.0°"),
        (178.0, -176.0, r"with a camera roll of -17[56]\.\d° in place of 178.0°"),
    ],
)
@pytest.mark.parametrize("scene", ["quay-day", "work-cycles"])
def test_a_wrong_roll_is_named(scene, roll, used, text):
    changes = {"camera.offset_x_m": 1.2, "camera.roll_deg": roll, "camera.beta_deg": 4.0, "frames": 192}
    changes |= {"swing.settle_s": 25.0} if scene == "work-cycles" else {}
    rows, true = rows_of(scenes.load(scene, changes))
    wrong, right = (camera_rotation(np.radians(4.0), 0.0, np.radians(deg)) for deg in (used, roll))
    camera = places(rows, "camera")
    ray = (places(rows, "grab") - camera) @ (wrong @ right.T).T
    measured = swing_of(on_ropes(camera, ray, ropes(rows)[:, 0]))[0]
    measured += np.random.default_rng(0).normal(0, np.deg2rad(0.02), len(true))
    assert re.fullmatch(f"The angles are as (with a .*, or )?{text}(, or .*)?", named(measured, true, rows))
    for i, row in enumerate(rows):
        row.roll_deg += 20.0 * (i % 2)  # of rolls that differ, no one was taken for another
    assert "roll" not in getattr(likely(measured, true, rows, None), "text", "")


@pytest.mark.parametrize(
    ("what", "exchange"),
    [
        ("x and y of the image were exchanged", lambda pixel, middle: pixel[::-1] - middle),
        ("x and y of the image were exchanged", lambda pixel, middle: (pixel - middle)[::-1]),
        ("left and right of the image were exchanged", lambda pixel, middle: (pixel - middle) * [-1, 1]),
        ("top and bottom of the image were exchanged", lambda pixel, middle: (pixel - middle) * [1, -1]),
        ("the image were turned upside down", lambda pixel, middle: middle - pixel),
    ],
    ids=["x and y", "about the principal point", "left and right", "top and bottom", "upside down"],
)
@pytest.mark.parametrize(("tilt", "offset"), [(True, True), (False, True), (True, False), (False, False)])
def test_an_exchange_of_axes_or_sides_is_named(what, exchange, tilt, offset, request):
    changes = {
        "camera.offset_x_m": 1.2,
        "camera.offset_y_m": 0.5,
        "camera.roll_deg": 3.0,
        "camera.beta_deg": 4.0,
        "camera.tilt_azimuth_deg": 20.0,
    }
    rows, true = rows_of(scenes.load("calm-day", changes | {"frames": 40}))
    measured = []
    for row in rows:
        pixel, middle = np.array([row.ideal_u_px, row.ideal_v_px]), np.array([row.cx_px, row.cy_px])
        x, y = exchange(pixel, middle) / row.fx_px
        camera = np.reshape(row.jib_from_camera, (3, 4))
        rotation = camera[:, :3] if tilt else camera_rotation(0.0, 0.0, np.radians(3.0))
        rope = np.linalg.norm(np.reshape(row.jib_from_grab, (3, 4))[:, 3])
        place = camera[:, 3] if offset else np.zeros(3)
        measured.append(swing_of(on_ropes(place[None], (rotation @ [x, y, 1.0])[None], rope))[0][0])
    out = " and the ".join(["tilt"] * (not tilt) + ["offset"] * (not offset))
    text = f"if {what}{out and f', and the {out} left out'}"
    found = getattr(likely(np.array(measured), true, rows, None), "text", "")
    if tilt or offset or request.node.callspec.id.endswith("-x and y"):
        first = "The angles are as " if "x and y" in what else ".*(as|, or) "  # sides look like others
        assert re.match(f"{first}{text}(, or .*)?$", found)
    else:  # of a camera that hangs level in the rope's exit, nothing changes
        assert "exchanged" not in found
        assert "upside" not in found


def test_on_a_rope_of_constant_length_any_offset_and_a_tilt_are_named_together():
    rows, true = rows_of(scenes.load("free-swing", {"camera.offset_x_m": 0.4, "camera.offset_y_m": 0.7, "frames": 192}))
    text = named(leaning(rows, shift=np.array([0.1, -0.25]) / 18), true, rows)
    assert re.search(r"tilt that is 0\.8\d° wrong, .*, or with a horizontal camera offset of \(0\.50, 0\.45\) m", text)


def test_offsets_that_leave_the_same_errors_are_named_together():
    changes = {"camera.offset_x_m": 0.5, "camera.offset_y_m": -0.5, "frames": 32}
    rows, true = rows_of(scenes.load("quay-day", changes))
    assert named(leaning(rows, shift=[-1.0, 1.0] / ropes(rows)), true, rows, 0.005) == (
        "The angles are as if the camera's horizontal offset of 0.71 m were applied with the opposite sign, "
        "or if x and y of the camera's offset were exchanged"
    )


def test_an_offset_that_differs_between_frames_is_named():
    changes = {"vary": {"camera.offset_y_m": {"dist": "choice", "values": [-0.9, -0.7, 0.7, 0.9]}}, "frames": FRAMES}
    rows, true = rows_of(scenes.load("quay-day", changes | {"camera.offset_x_m": 0.1, "clip.clip_frames": 1}))
    offset = places(rows, "camera")[:, :2]
    assert abs(offset.mean(axis=0)[1]) < 0.3
    assert re.search("offset of 0.8. m were left out$", named(leaning(rows, shift=-offset / ropes(rows)), true, rows))


@pytest.mark.parametrize("follows", [False, True])
def test_a_lens_that_is_taken_to_be_without_distortion_is_named(follows):
    changes = {"camera.distortion": {"k1": -0.3, "k2": 0.1}, "camera.beta_deg": 6.0, "swing.settle_s": 25.0}
    rows, true = rows_of(scenes.load("work-cycles", changes))
    rotation = np.reshape([row.jib_from_camera for row in rows], (-1, 3, 4))[..., :3]
    pixels = ([(row.grab_u_px, row.grab_v_px) for row in rows], [(row.ideal_u_px, row.ideal_v_px) for row in rows])
    k = rows[0]
    rays = [np.insert((np.array(some) - (k.cx_px, k.cy_px)) / k.fx_px, 2, 1, axis=1) for some in pixels]
    bent, straight = (np.einsum("nij,nj->ni", rotation, r / np.linalg.norm(r, axis=1, keepdims=True)) for r in rays)
    by = (bent - straight)[:, :2]
    measured = leaning(rows, lean=-by.mean(axis=0) if follows else np.zeros(2), shift=by)
    assert named(measured, true, rows, 0.01) == "The angles are as if the lens's distortion were left out"


@pytest.mark.parametrize("late", [-2, 1, 5])
def test_a_delay_is_named(late):
    rows, true = truth("offset", "beside")
    found = likely(np.roll(true, late), true, rows, 0.5 * np.arange(len(true)))
    frames = f"{abs(late)} frame{'s' * (abs(late) > 1)} ({abs(late) / 2:.2f} s)"
    assert found.text == f"The measured angles are those of {frames} {'before' if late > 0 else 'after'} theirs"


@pytest.mark.parametrize("factor", [0.9, 1.1])
@pytest.mark.parametrize("tilt", ["follows", "known", "estimated", "in wind"])
def test_a_focal_length_is_named(tilt, factor):
    rows, true = truth("weather", "calm")
    axis = np.reshape([row.jib_from_camera for row in rows], (-1, 3, 4))[..., 2]
    ray = places(rows, "grab") - places(rows, "camera")
    level = np.cross(axis, np.cross(ray, axis)) / np.sum(ray * axis, axis=1, keepdims=True)  # on the image plane
    wrong = axis + level * factor
    wrong /= np.linalg.norm(wrong, axis=1, keepdims=True)
    off = wrong - ray / np.linalg.norm(ray, axis=1, keepdims=True)
    swing = places(rows, "grab") / ropes(rows) + off
    known = np.arctan2(np.linalg.norm(swing[:, :2], axis=1), -swing[:, 2])
    moved, lean = off[:, :2], -off.mean(axis=0)[:2]
    measured = {
        "known": known, "follows": np.arctan(factor * np.tan(true)), "estimated": leaning(rows, moved, lean),
        "in wind": leaning(rows, moved, lean + [0.0, np.deg2rad(1.5)]),
    }[tilt]  # fmt: skip
    noise = np.random.default_rng(0).normal(0, np.deg2rad(0.02), len(true))
    found = likely(measured + noise, true, rows, None)
    f_px = float(found.text.removeprefix("The angles are as with a focal length of ").partition(" px")[0])
    assert f_px == pytest.approx(rows[0].fx_px / factor, rel=0.02)
    assert np.rad2deg(found.rms) < 0.05
    beside = r"\), and with a camera tilt that is 1\.\d\d° wrong, [34]\.\d° with an azimuth of 2\d° in place of"
    assert bool(re.search(beside, found.text)) == (tilt == "in wind")


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (lambda m: 100 * m, "Rope lengths are 100 times the true ones"),
        (lambda m: m - 3.0, "Rope lengths are 3.00 m too short"),
    ],
)
def test_lengths_off_by_a_factor_or_a_constant_are_named(read, text):
    lengths = np.random.default_rng(0).normal(20, 4, FRAMES)
    assert of_rope(read(lengths) + np.random.default_rng(1).normal(0, 0.05, FRAMES), lengths).text == text


def test_late_lengths_are_named_to_parts_of_a_frame_and_apart_from_the_displays_own_delay():
    time = np.arange(FRAMES, dtype=float)

    def read(late_s):
        lengths = 15 + 5 * np.sin((time - late_s) / 10) + np.random.default_rng(1).normal(0, 0.01, FRAMES)
        return np.where(time < late_s, np.nan, lengths)

    lengths = 15 + 5 * np.sin(time / 10)
    assert re.fullmatch(r"Rope lengths are 1\.(49|50|51) s late", of_rope(read(1.5), lengths, time).text)
    assert re.fullmatch(r"Rope lengths are 1\.(49|50|51) s early", of_rope(read(-1.5), lengths, time).text)
    own, ages_s = r", of which 0\.5 to 0\.7 s are the display's own delay", (0.5, 0.7)
    found = of_rope(read(0.9), lengths, time, ages_s=ages_s)
    assert re.fullmatch(rf"Rope lengths are 0\.(89|90|91) s late{own} and 0\.2 to 0\.4 s the pipeline's", found.text)
    assert not found.own
    assert re.fullmatch(r"Rope lengths are 0\.(29|30|31) s late", of_rope(read(0.3), lengths, time, ages_s=ages_s).text)
    for late_s in (0.5, 0.6, 0.7):
        found = of_rope(read(late_s), lengths, time, ages_s=ages_s)
        assert re.fullmatch(rf"Rope lengths are 0\.\d\d s late{own}", found.text)
        assert found.own
        found = of_rope(read(late_s) - 1.0, lengths, time, ages_s=ages_s)
        assert re.fullmatch(r"Rope lengths are (0\.9\d|1\.0\d) m too short", found.text)
        found = of_rope(1.08 * read(late_s), lengths, time, ages_s=ages_s)
        assert re.fullmatch(r"Rope lengths are 1\.0[78]\d? times the true ones", found.text)
    assert of_rope(read(0.0) + (time > 40), lengths, time) is None  # the last of them are wrong, and not late
    still = np.full(FRAMES, 20.0)
    assert of_rope(still + 3.0 * (time > 40), still, time) is None
    both = "Rope lengths are 1.15 times the true ones, or 3.00 m too long"
    assert of_rope(still + 3.0, still, time, ages_s=(5.0, 5.2)).text == both
    drawn = np.random.default_rng(0).normal(20, 4, FRAMES)
    assert of_rope(np.roll(drawn, 1), drawn).text == "Rope lengths are those of 1 frame before theirs"


def test_centres_of_other_frames_are_named():
    time, rng = np.arange(FRAMES) / 4, np.random.default_rng(0)
    true = np.column_stack([100 * np.sin(time), 60 * np.cos(time)]) + 300
    found = np.roll(true, 1, axis=0) + rng.normal(0, 1, true.shape)
    assert of_centres(found, true, time).text == "The measured centres are those of 1 frame (0.25 s) before theirs"
    assert of_centres(true + rng.normal(0, 3, true.shape), true, time) is None
    assert of_centres(true + 20.0, true, time) is None
    assert of_centres(np.full(true.shape, np.nan), true, time) is None
