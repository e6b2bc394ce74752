"""`simgrab new` writes scenes that load, show what data sheets say, and states what it assumed."""

import itertools
import math
from typing import get_args

import numpy as np
import pytest
import trimesh
from commands import run

from simgrab.dataset.notices import notices
from simgrab.errors import ScenarioError, SuiteError
from simgrab.judge.check import suite
from simgrab.match import data_sheets
from simgrab.match.cli.new import GRABS, HEADS_M, PAINTS, WEATHERS
from simgrab.model import scenes
from simgrab.model.geometry import Intrinsics
from simgrab.model.scenario import Cargo, Hold, RigidMount
from simgrab.world.extensions import Recipe
from simgrab.world.scenery.clearance import check_camera
from simgrab.world.scenery.meshes.jib import jib_steel
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.scenery.plan import draw_up
from simgrab.world.trajectory.clip import ClipMotion

LENSES = [(name, mm) for name, (_, _, lenses) in data_sheets.CAMERAS.items() for mm in lenses]


def new(path, *options):
    status, out, problem = run("new", path, "--yes", *options)
    assert (status, problem) == (0, ""), problem
    return scenes.load(path), out


def spans(camera: Intrinsics) -> tuple[float, float]:
    """Angle between the rays of opposite edges, across and up, degrees."""
    w, h = camera.width_px, camera.height_px
    left, right, top, bottom = camera.rays([(0, h / 2), (w, h / 2), (w / 2, 0), (w / 2, h)])
    return math.degrees(math.acos(left @ right)), math.degrees(math.acos(top @ bottom))


def tan(angle_deg):
    return math.tan(math.radians(angle_deg) / 2)


@pytest.mark.parametrize(("name", "mm"), LENSES)
def test_a_camera_spans_the_field_of_view_of_its_data_sheet(name, mm, tmp_path):
    width, height, lenses = data_sheets.CAMERAS[name]
    scene, _ = new(tmp_path / "a.toml", "--camera", f"DH-{name.split()[1].lower()}E", "--lens", mm)  # a variant of it
    assert (scene.camera.width_px, scene.camera.height_px) == (width, height)
    across, up = spans(scene.camera.intrinsics)
    assert tan(across) == pytest.approx(tan(lenses[mm][0]), rel=1e-3)
    assert up == pytest.approx(lenses[mm][1], abs=1.6)  # rounded to 1° on the sheet, and k1 to k3 of a wide lens
    assert scene.vary["camera.focal.focal_length_px"].low < scene.camera.focal.focal_length_px


def test_none_is_an_answer_where_it_is_the_default(tmp_path):
    none, _ = new(tmp_path / "a.toml", "--camera", "none", "--fov", "None")
    assert none.to_dict() | {"name": ""} == new(tmp_path / "b.toml")[0].to_dict() | {"name": ""}
    assert run("new", tmp_path / "c.toml", "--yes", "--grab", "none")[0] == 2


def test_an_option_without_effect_is_named(tmp_path):
    listed = ["--camera", "2143", "--lens", 4]
    scene, out = new(tmp_path / "a.toml", *listed, "--sensor", "1/1.8")
    f_px = scene.camera.focal.focal_length_px
    assert f"warning: the focal length is {f_px:.0f} px, as Hikvision DS-2CD2143G2-I" in out
    assert "as IMX347, 4 mm, would have 1379 px" in out
    assert "no effect beside" not in out
    assert "--sensor: no effect beside --camera" in new(tmp_path / "b.toml", "--camera", 2143, "--sensor", "1/3")[1]
    assert "--lens: no effect beside --fov" in new(tmp_path / "c.toml", "--fov", 80, "--lens", 4)[1]


def test_a_fixed_scene_of_cycles_is_one_clip_that_shows_the_rope_length_if_asked(tmp_path):
    scene, _ = new(tmp_path / "a.toml", "--motion", "cycles", "--ropes", "8..18", "--fixed", "--display", "two-by-four")
    assert scene.clip.count(scene.frames) == 1
    assert scene.display.layout == "two-by-four"
    assert run("new", tmp_path / "b.toml", "--yes", "--display", "three-by-four")[0] == 2


def test_cargo_is_of_place_and_grab_alike(tmp_path):
    for cargo, more in itertools.product(get_args(Cargo), ((), ("--ropes", "20..40"))):
        scene, _ = new(tmp_path / f"{cargo}{len(more)}.toml", "--cargo", cargo, *more)
        assert isinstance(scene.place, Hold) == bool(more)
        assert scene.place.cargo == scene.grab.cargo == cargo
    scene, _ = new(tmp_path / "two.toml", "--cargo", "grain,sulphur")
    drawn = {(one.place.cargo, one.grab.cargo) for one in (Recipe(scene).variant(2 * i).scenario for i in range(20))}
    assert drawn == {("grain", "grain"), ("sulphur", "sulphur")}
    assert run("new", tmp_path / "a.toml", "--yes", "--cargo", "grain,sulphur", "--fixed")[0] == 2
    status, _, problem = run("new", tmp_path / "a.toml", "--yes", "--cargo", "ore", "--place", "random")
    assert (status, "--cargo: random places have cargo of each kind" in problem) == (2, True)


def test_a_range_of_tilts_is_what_varies(tmp_path):
    scene, out = new(tmp_path / "a.toml", "--tilt", "3..6")
    assert scene.vary["camera.beta_deg"].support() == (3, 6)
    assert (scene.camera.beta_deg, "within: the tilt, in any direction" in out) == (4.5, True)
    assert run("new", tmp_path / "c.toml", "--yes", "--tilt", "6..3")[0] == 2
    assert run("new", tmp_path / "b.toml", "--yes", "--tilt", "3..6", "--fixed")[0] == 2


def test_the_pitch_of_a_camera_that_luffing_tilts_is_stated(tmp_path):
    scene, out = new(tmp_path / "a.toml", "--motion", "cycles", "--mount", "rigid", "--ropes", "8..18")
    assert scene.camera.mount == RigidMount()
    assert f"pitch_deg_per_m = {RigidMount().pitch_deg_per_m:g} " in (tmp_path / "a.toml").read_text()
    assert f"pitches by {RigidMount().pitch_deg_per_m:g} degrees for each metre" in out


def test_a_lens_without_distortion_is_a_pinhole():
    for across, f_px in ((40, 2637.6), (90, 960)):
        up = 2 * math.degrees(math.atan(540 / f_px))
        c = data_sheets.barrel(1920, 1080, across, up)
        assert data_sheets.focal_px(1920, across, c) == pytest.approx(f_px, rel=1e-3)
        assert data_sheets.brown(1920, 1080, f_px, 0.0) == (0, 0, 0)


def test_of_sensor_and_lens_the_focal_length_is_their_ratio(tmp_path):
    for sensor, size, f_px in (
        ("1/2.8", "1920x1080", 4000 / 2.9),
        ('1/2.8"', "1296x972", 1000),
        ("imx335", "1296x729", 1000),
    ):
        path = tmp_path / f"{size}.toml"
        scene, out = new(path, "--sensor", sensor, "--lens", 4, "--size", size)
        assert scene.camera.focal.focal_length_px == pytest.approx(f_px, abs=0.05)
        assert "usual distortion" in out
        assert "is known here that has the shape" not in out
    # A picture of 5 MP is no part of the one 1/2.7" sensor that is known: on that format, pixels are 2 µm.
    scene, out = new(tmp_path / "five.toml", "--sensor", "1/2.7", "--lens", 4, "--size", "2592x1944")
    assert scene.camera.focal.focal_length_px == pytest.approx(4000 / 2.0, rel=0.05)
    assert "with the diagonal of OV2710" in out
    assert "the focal length is 1961 px if" in " ".join(out.split())
    assert "2400 px if the picture is a part of OV2710's" in " ".join(out.split())
    # Of the distortions that the model follows, one has rays that Newton's method does not find.
    scene, _ = new(tmp_path / "wide.toml", "--sensor", "1/2.7", "--lens", 2.8, "--size", "2688x1520")
    assert scene.camera.focal.focal_length_px == pytest.approx(1313.6, abs=0.5)
    # A short lens on a larger sensor, whose usual distortion no scene can have, gets less of it.
    scene, _ = new(tmp_path / "short.toml", "--sensor", "1/3", "--lens", 2.8)
    assert scene.camera.focal.focal_length_px == pytest.approx(1000)


@pytest.mark.parametrize(("offset", "around"), [("0,0.95,0", 0.01), ("0,0.4,0.1", 0.0), ("0,0.6,-0.3", 0.1)])
def test_a_camera_beside_the_jib_head_varies_without_touching_it(offset, around, tmp_path):
    scene, out = new(tmp_path / "port.toml", "--offset", offset)
    assert f"{around:g} m of the offset" in out
    assert "a rope hangs" not in out
    if not around:
        assert not any("offset" in key for key in scene.vary)
        return
    ends = [scene.vary[f"camera.offset_{axis}_m"].support() for axis in "xyz"]
    assert np.ptp(ends, axis=1) == pytest.approx(np.full(3, 2 * around))
    for place in itertools.product(*ends):
        check_camera(np.array(place), jib_steel(Ropes.of(scene.jib, 4)))


def test_a_rope_that_is_near_the_lens_is_stated(tmp_path):
    _, out = new(tmp_path / "port.toml", "--offset=-0.15,-0.55,-0.2")
    assert "warning: --offset: a rope hangs 0.06 m from the lens" in out


@pytest.mark.parametrize("grab", [*GRABS, "drum.glb"])
def test_facts_become_keys_and_their_tolerances(grab, tmp_path):
    if grab not in GRABS:
        trimesh.creation.cylinder(radius=1.2, height=2.6).export(tmp_path / grab)
    given = ["--grab", grab if grab in GRABS else tmp_path / grab]
    if grab in GRABS[1:]:
        given += ["--volume", 9]
    given += ["--paint", "blue"]
    given += ["--light", "both", "--weather", ",".join(WEATHERS), "--ropes", "9..31", "--offset", "0.2,-0.5,-0.4"]
    scene, out = new(tmp_path / "p" / "Our port.toml", *given)
    assert scene.name == "our-port"
    assert scene.grab.paint_rgb == tuple(PAINTS["blue"])
    assert isinstance(scene.place, Hold)  # the ropes reach below the quay
    assert scene.swing.rope_length_m.support() == (9, 31)
    assert scene.camera.offset_m == (0.2, -0.5, -0.4)
    moods = next(iter(scene.vary.values()))
    shares = {light: sum(p for p, name in zip(moods.probabilities, moods.names, strict=True) if light in name)
              for light in ("day", "night", *WEATHERS)}  # fmt: skip
    assert shares == pytest.approx({"day": 1 / 2, "night": 1 / 2} | dict.fromkeys(WEATHERS, 1 / len(WEATHERS)))
    assert len({one["weather"]["visibility_m"] for one in moods.values if "visibility_m" in one["weather"]}) == 3
    if grab in GRABS[1:]:
        assert scene.vary["grab.volume_m3"].support() == pytest.approx((8.1, 9.9))
    assert "--rate 25" in out
    assert ("grab.file: taken as 2.40 × 2.60 × 2.40 m" in out) == (grab not in GRABS)
    assert "--ropes" not in out


@pytest.mark.parametrize("grab", ["scissors", "drum.glb"])
def test_random_places_vary_as_in_training_around_what_is_stated(grab, tmp_path):
    if grab not in GRABS:
        trimesh.creation.cylinder(radius=1200, height=2600).export(tmp_path / grab)
    given = ["--grab", tmp_path / grab if grab not in GRABS else grab, "--mount", "fixed", "--paint", "blue"]
    given += ["--wind", 5]
    scene, out = new(tmp_path / "a.toml", "--place", "random", *given)
    assert ("assumed: --scale 0.001: metres" in out) == (grab not in GRABS)
    assert "warning: --mount: only stated in camera.toml" in out
    assert type(scene.camera.mount).__name__ == "FixedMount"
    assert scene.swing.rope_length_m.support() == (8, 22)
    assert scene.swing.yaw_deg == scenes.load("quay-day").swing.yaw_deg  # as at the quay: ropes turn the grab back
    seen = [Recipe(scene).variant(frame).scenario for frame in range(0, 96, 8)]
    assert len({type(one.place) for one in seen}) > 2
    assert {one.grab.paint_rgb for one in seen} == {tuple(PAINTS["blue"])}
    assert max(one.grab.wear for one in seen) <= 0.5
    assert {(one.weather.rain_mm_h, one.weather.wind_m_s) for one in seen} == {(0.0, 5.0)}  # clear unless stated
    assert not any("load" in line for line in notices(Recipe(scene)))
    assert "ropes are shortened where the grab would reach the ground" not in out
    assert "shortened" in new(tmp_path / "c.toml", "--place", "random", *given, "--ropes", "20..40")[1]
    plain, _ = new(tmp_path / "d.toml", "--place", "random", *given[:2])
    paints = {Recipe(plain).variant(frame).scenario.grab.paint_rgb for frame in range(0, 96, 8)}
    assert len(paints) > 3
    for clash in (["--motion", "cycles"], ["--fixed"]):
        assert run("new", tmp_path / "b.toml", "--yes", "--place", "random", *clash)[0] == 2


def test_unit_and_axis_of_a_model_are_stated_where_its_size_shows_neither(tmp_path):
    trimesh.creation.box(extents=(216, 238, 180)).export(tmp_path / "a.stl")
    given = "new", tmp_path / "a.toml", "--yes", "--grab", tmp_path / "a.stl"
    code, _, err = run(*given)
    assert code == 2
    assert "--scale: the grab would be 216 × 238 × 180 m" in err
    assert "(scale = 0.01) or inches" in err
    assert not (tmp_path / "a.toml").exists()
    scene, out = new(tmp_path / "a.toml", "--grab", tmp_path / "a.stl", "--scale", 0.01, "--up", "y")
    assert (scene.grab.scale, scene.grab.up) == (0.01, "y")
    assert "taken as 2.16 × 1.80 × 2.38 m" in out
    assert "--scale" not in out
    for option in (("--scale", 2), ("--up", "y")):
        code, _, err = run("new", tmp_path / "b.toml", "--yes", "--grab", "scissors", *option)
        assert code == 2
        assert f"{option[0]}: scissors is no file" in err


def test_jib_heads_are_as_high_as_a_scene_admits(tmp_path):
    scene, _ = new(tmp_path / "a.toml", "--height", HEADS_M[1], "--fixed")
    assert scene.jib.head_height_m == HEADS_M[1]
    for height in HEADS_M:
        beyond = height + 0.1 * (-1) ** (height == HEADS_M[0])
        assert run("new", tmp_path / "b.toml", "--yes", "--height", beyond)[0] == 2
        with pytest.raises(ScenarioError):
            scenes.load("quay-day", {"jib.head_height_m": beyond})
        scenes.load("quay-day", {"jib.head_height_m": height})


def test_a_working_crane_moves_within_its_ropes(tmp_path):
    scene, _ = new(tmp_path / "a.toml", "--motion", "cycles", "--mount", "rigid", "--rate", 9)
    assert (scene.swing.work.dig_rope_m, scene.swing.work.carry_rope_m, scene.clip.frame_rate_hz) == (22, 8, 9)


def test_a_working_crane_stays_clear_of_pile_and_hopper(tmp_path):
    options = ["--fixed", "--motion", "cycles", "--height", 35, "--grab", "scissors", "--volume", 20]
    new(tmp_path / "a.toml", *options, "--ropes", "21.9..28.4")
    changes = {"clip.clip_frames": 150, "clip.frame_rate_hz": 1.0, "frames": 150}
    for seed in range(2):
        moved = scenes.load(tmp_path / "a.toml", changes | {"seed": seed})
        plan = draw_up(moved)
        for moment in itertools.islice(ClipMotion(moved, 0), 150):
            plan.check_clearance(moment, moment.grab.jib_from_grab.apply(plan.grab_points(moment.grab)))
    assert run("new", tmp_path / "b.toml", "--yes", *options, "--ropes", "21.9..28.6")[0] == 2
    assert run("new", tmp_path / "b.toml", "--yes", *options, "--ropes", "22.1..28.4")[0] == 2


def test_a_fixed_scene_suits_a_suite_and_varies_its_weather_alone(tmp_path):
    def place(name, *options):
        new(tmp_path / f"{name}.toml", "--fixed", *options)
        (tmp_path / "suite.toml").write_text(f'name = "s"\n[scenes.a]\nscene = "{name}.toml"\n')
        return suite.load(tmp_path / "suite.toml").scenario("a").vary

    assert place("one") == {}
    (weather,) = place("two", "--weather", "clear,rain", "--grab", "clamshell").values()
    assert weather.names == ("day, clear", "day, rain")
    new(tmp_path / "loose.toml")
    (tmp_path / "suite.toml").write_text('name = "s"\n[scenes.a]\nscene = "loose.toml"\n')
    with pytest.raises(SuiteError, match="one camera"):
        suite.load(tmp_path / "suite.toml")


def test_wind_carries_the_rain_and_pushes_the_grab(tmp_path):
    scene, out = new(tmp_path / "a.toml", "--wind", 12, "--weather", "rain")
    assert (scene.weather.wind_m_s, scene.weather.rain_mm_h) == (12, 8)
    assert "2 degrees, whatever the wind, which carries rain, snow and dust alone;" in out
    scene, _ = new(tmp_path / "b.toml", "--wind", "12 m/s", "--motion", "cycles", "--light", "both")
    assert scene.swing.wind.mean_m_s == 12
    (moods,) = (factor for key, factor in scene.vary.items() if "weather" in key)
    assert [mood["weather"]["wind_m_s"] for mood in moods.values] == [12, 12]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--camera", "nonesuch"], "DS-2CD2143G2-I"),
        (["--camera", "2143", "--lens", 5], "2.8, 4 mm"),
        (["--sensor", "1/9"], "1/2.8"),
        (["--lens", "nan"], "0.5 to 100"),
        (["--lens", 1.2], "too wide"),
        (["--fov", "84x80"], "43° to 54°"),
        (["--ropes", "22..8"], "above the first"),
        (["--grab", "crab"], "orange-peel"),
        (["--paint", "pink"], "orange, yellow"),
        (["--volume", 5], "clamshell"),
        (["--weather", "hail"], "dust"),
        (["--wind", "gale"], "0 to 40"),
        (["--offset", "0,0.6,0.5"], "0,0.6,0.5 is in the jib head's steel"),
        (["--offset=-0.8,0.7,0"], "-0.8,0.7,-0.2 is not"),
        (["--size", "64x64", "--fov", 60], "focal_length_px"),
        (["--motion", "cycles", "--ropes", "8..24"], "22.2 m lower it on the pile"),
        (["--motion", "cycles", "--ropes", "17..22"], "15.7 m carry this grab over the hopper"),
    ],
)
def test_nonsense_is_refused_and_writes_nothing(options, word, tmp_path):
    status, _, problem = run("new", tmp_path / "a.toml", "--yes", *options)
    assert status == 2
    assert word in problem
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a\nframes = 7", "\udcff", 'é\x7f"'])
def test_a_file_of_any_name_holds_what_was_asked_for(name, tmp_path):
    drum = tmp_path / f"{name}.glb"
    trimesh.creation.cylinder(radius=1.2, height=2.6).export(tmp_path / "drum.glb")
    (tmp_path / "drum.glb").rename(drum)
    assert new(tmp_path / f"{name}.toml")[0].frames == 200
    status, _, problem = run("new", tmp_path / "b.toml", "--yes", "--grab", drum)
    assert (status, "is not UTF-8" in problem) == ((2, True) if name == "\udcff" else (0, False)), problem


def test_no_file_is_overwritten(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("mine")
    assert run("new", path, "--yes")[0] == 2
    assert path.read_text() == "mine"


def test_the_usual_distortion_is_the_median_of_the_cameras():
    found = [data_sheets.barrel(w, h, *fov) for w, h, lenses in data_sheets.CAMERAS.values() for fov in lenses.values()]
    assert np.median(found) == pytest.approx(data_sheets.BARREL, abs=0.01)


def test_units_and_words_between_numbers_are_understood(tmp_path):
    plain, said = (
        new(tmp_path / f"{name}.toml", "--lens", lens, "--ropes", ropes, "--grab", "clamshell", "--volume", volume)[0]
        for name, lens, ropes, volume in (("a", "4", "9..24", "9"), ("b", "4 mm", "9 to 24", "9 m3"))
    )
    assert plain.to_dict() | {"name": ""} == said.to_dict() | {"name": ""}


def test_night_is_exposed_for_longer_than_day(tmp_path):
    scene, _ = new(tmp_path / "a.toml", "--light", "both", "--weather", "clear,rain")
    (factor,) = (factor for key, factor in scene.vary.items() if "shutter.exposure_s" in key)
    exposures = {value["optics.night_mode"]: value["shutter.exposure_s"] for value in factor.values}
    assert exposures["on"] > exposures["off"]


def test_listed_cameras_that_disagree_with_sensor_and_lens_are_named(tmp_path):
    _, said = new(tmp_path / "a.toml", "--size", "2560x1440", "--sensor", "1/3", "--lens", "3.6")
    assert "lens have other degrees across: Dahua IPC-HFW1430DT-STW 76; see --camera" in said
    assert "other degrees" not in new(tmp_path / "b.toml", "--size", "2560x1440", "--lens", "50")[1]
