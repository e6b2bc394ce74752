"""What `simgrab studio` answers about scenes, what it refuses, and that what it saves renders what it showed."""

import json
import struct
import subprocess
import threading
from pathlib import Path

import msgspec
import pytest
import trimesh
from click.testing import CliRunner
from http_requests import ask

import simgrab
from simgrab.cli import cli
from simgrab.errors import ScenarioError
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.pages.studio import commands, measuring, rendering, studio
from simgrab.pages.studio.documents import Documents, ExistsError
from simgrab.pages.studio.turns import SupersededError, Turns

HOSTILE = "<script>document.title=1<b>"
SMALL = """
base = "quay-day"
name = "yard"
frames = 6
description = "<script>document.title=1<b>"
[camera]
width_px = 320
height_px = 180
focal = { model = "lens", pixels_per_mm = 57.0 }
[place]
model = "plain"
[jib]
head = "none"
[image]
format = "png"
shadow_map_px = 1024
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a hostile name, a scene, a model below it, and one outside."""
    folder = tmp_path_factory.mktemp("studio") / HOSTILE.replace("/", "")
    (folder / "parts").mkdir(parents=True)
    (folder / "yard.toml").write_text(SMALL)
    (folder / "pyproject.toml").write_text("[tool.other]\n")
    (folder / ".hidden.toml").write_text(SMALL)  # which is not opened
    for path in (folder / "parts" / "box.stl", folder.parent / "outside.stl"):
        path.write_bytes(trimesh.creation.box((2.0, 2.0, 3.0)).export(file_type="stl"))
    (folder / "parts" / "link.stl").symlink_to(folder.parent / "outside.stl")
    return folder


@pytest.fixture(scope="module")
def documents(folder):
    return Documents(folder / "yard.toml", folder)


@pytest.fixture(scope="module")
def address(documents):
    with studio.serving(documents) as address:
        yield address


@pytest.fixture
def scene(documents):
    return documents.start.to_dict()


def post(address, path, body, **keys):
    return ask(address, path, "POST", body=json.dumps(body).encode(), **keys)


def frame(address, scene, number=0, **keys):
    answer = post(address, "/api/frame", {"scene": scene, "frame": number} | keys)
    assert answer.status == 200, answer.body
    (length,) = struct.unpack(">I", answer.body[:4])
    return json.loads(answer.body[4 : 4 + length]), answer.body[4 + length :]


def refused(address, scene, path="/api/frame", **keys):
    answer = post(address, path, {"scene": scene} | keys)
    assert answer.status == 422, answer.body
    assert answer.json["error"].isprintable()
    return answer.json


def plain(scenario):
    """A scenario's plain data, with what a file leaves out, as JSON gives it."""
    return msgspec.json.decode(msgspec.json.encode(scenario))


def test_the_page_gets_the_schema_with_units_the_default_and_the_scenes_there_are(address):
    start = ask(address, "/api/start").json
    assert start["schema"]["$defs"]["Camera"]["properties"]["beta_deg"]["unit"] == "°"
    assert set(start["scene"]) == {*Scenario.__struct_fields__}
    assert start["default"] == plain(Scenario())
    assert {"yard.toml", "quay-day"} <= set(start["scenes"])
    assert not {"pyproject.toml", ".hidden.toml"} & set(start["scenes"])


def test_what_is_saved_renders_the_bytes_that_were_shown(address, scene, folder, tmp_path):
    scene["camera"]["beta_deg"] = 5.0
    scene["light"]["sun_azimuth_deg"] = 20.0
    scene["weather"] |= {"visibility_m": 90.0, "lens_drops": 3}
    scene["swing"]["alpha"]["sigma_deg"] = 6.0
    small, _ = frame(address, scene, 2, small=True)
    about, shown = frame(address, scene, 2)
    assert (small["small"], about["small"]) == (True, False)
    path = Path(post(address, "/api/save", {"scene": scene, "path": "changed.toml"}).json["path"])
    assert path == folder / "changed.toml"
    summary = CliRunner().invoke(
        cli, ["render", str(path), "--out", str(tmp_path / "out"), "--workers", "1", "--quiet"]
    )
    assert summary.exit_code == 0, summary.output
    row = simgrab.open(tmp_path / "out").rows[2]
    assert (tmp_path / "out" / row.file).read_bytes() == shown
    assert about["values"]["alpha_deg"] == row.alpha_deg
    assert about["truth"]["box"] == [row.box_x0_px, row.box_y0_px, row.box_x1_px, row.box_y1_px]


def test_small_frames_show_the_same_and_keep_the_world(address, scene):
    about, _ = frame(address, scene, 1)
    small, data = frame(address, scene, 1, small=True)
    assert data.startswith(b"\xff\xd8\xff")
    for name in ("alpha_deg", "beta_deg", "theta_deg", "rope_length_m"):
        assert small["values"][name] == pytest.approx(about["values"][name])
    large = msgspec.convert(scene, Scenario)
    assert rendering.reduced(scenes.load("quay-day")).camera.width_px == rendering.PREVIEW_WIDTH_PX
    assert rendering.reduced(large).camera == large.camera  # it is small already
    digits = scenes.load("quay-day", {"display.layout": "two-by-four", "camera.width_px": 640, "camera.height_px": 360})
    assert rendering.reduced(digits).display == digits.display


def test_a_small_frame_of_another_world_builds_it_for_full_frames_too(documents):
    made = rendering.Rendering()
    renderers = []
    for small in (True, False, True):
        made.picture("a", rendering.Wish(documents.start, 0, small)).result()
        renderers.append(made.turns.ask("test", lambda: made._generators["a"].scene(0).renderer).result())
    made.end()
    assert renderers[0] is renderers[1] is renderers[2]


def test_an_error_names_its_key(address, scene):
    scene["camera"]["beta_deg"] = 99
    assert refused(address, scene)["key"] == "camera.beta_deg"
    scene["camera"]["beta_deg"] = 3
    scene["swing"]["rope_length_m"] = {"dist": "constant", "value": 40.0}
    found = refused(address, scene)
    assert found["key"] == "swing.rope_length_m"
    assert "ground" in found["problem"]
    scene["vary"] = {"camera.beta_deg": {"dist": "uniform", "low": 0.0, "high": 50.0}}
    scene["swing"]["rope_length_m"]["value"] = 20.0
    scene["clip"]["clip_frames"] = 3
    assert refused(address, scene)["key"] == "vary.camera.beta_deg"
    assert refused(address, scene | {HOSTILE: 1})["key"] == HOSTILE  # the page shows it as text
    assert refused(address, {"swing": HOSTILE})["key"] == "swing"
    assert refused(address, scene | {"vary": {}}, frame=99)["key"] == "frames"


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b'{"scene":1,"x":2}', b"[" * 100_000, b'{"scene":' + b"[" * 90_000,
                                  b'{"scene":{"a":1e999}}', b'{"scene":{"seed":1' + b"0" * 5000 + b"}}",
                                  b'{"scene":{"name":"\\ud800"}}', b'{"scene":null}', b'{"scene":{},"side":"c"}',
                                  b'{"scene":{},"frame":1e9}', b'{"scene":{},"frame":-1}'])  # fmt: skip
def test_a_request_that_cannot_be_read_is_refused_in_one_line(address, body):
    answer = ask(address, "/api/frame", "POST", body=body)
    assert answer.status == 422
    assert answer.json["error"].isprintable()


def test_a_scene_of_10_mb_is_refused(address, scene, tmp_path):
    scene["description"] = "x" * 10_000_000
    assert post(address, "/api/frame", {"scene": scene}).status == 413
    (tmp_path / "large.toml").write_text(f'description = "{"x" * 10_000_000}"')
    result = CliRunner().invoke(cli, ["studio", str(tmp_path / "large.toml"), "--no-open"])
    assert isinstance(result.exception, ScenarioError)
    assert "limit" in str(result.exception)


ELSEWHERE = [
    "../x.toml", "/tmp/x.toml", "parts/../../x.toml", "..\\x.toml", ".hidden.toml", ".git/x.toml", "x.txt", "x", "",
    "no/folder.toml", "x.toml/y.toml", "a\0.toml", "C:/x.toml", "x\n.toml/../../../y.toml", "link.toml", "out/x.toml",
    "pyproject.toml", "dir.toml",
]  # fmt: skip


@pytest.mark.parametrize("name", ELSEWHERE)
def test_nothing_is_saved_elsewhere_or_over_other_files(documents, folder, tmp_path, name):
    for link, target in (("link.toml", tmp_path / "target.toml"), ("out", tmp_path)):
        if not (folder / link).is_symlink():
            (folder / link).symlink_to(target)
    (folder / "dir.toml").mkdir(exist_ok=True)
    before = {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()}
    with pytest.raises(ScenarioError):
        documents.save(documents.start, name, replace=True)
    assert {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()} == before
    assert list(tmp_path.iterdir()) == []


def test_a_scene_file_is_replaced_only_where_that_is_wanted(documents, folder):
    documents.save(documents.start, "parts/twice.toml")
    changed = scenes.load(folder / "yard.toml", {"seed": 3})
    with pytest.raises(ExistsError, match="exists"):
        documents.save(changed, "parts/twice.toml")
    assert scenes.load(folder / "parts" / "twice.toml").seed == 0
    documents.save(changed, "parts/twice.toml", replace=True)
    assert scenes.load(folder / "parts" / "twice.toml") == changed


@pytest.mark.parametrize(
    "name", ["../yard.toml", "/etc/hostname", "/etc/passwd", "yard", "parts/box.stl", "", "pyproject.toml"]
)
def test_no_other_file_is_opened(address, name):
    answer = ask(address, f"/api/open?scene={name}")
    assert answer.status == 422
    assert "root:" not in answer.body.decode()


def test_scenes_of_the_folder_and_bundled_ones_are_opened(address, documents):
    assert ask(address, "/api/open?scene=yard.toml").json == plain(documents.start)
    assert ask(address, "/api/open?scene=water-side").json["place"]["model"] == "water"


def mesh(file):
    return {"model": "mesh", "file": file}


FOREIGN = [
    "../outside.stl", "parts/../../outside.stl", "parts/link.stl", "/etc/passwd", "parts/none.stl", "C:/x.stl",
    "..\\outside.stl", "parts\0.stl", "yard.toml", "parts",
]  # fmt: skip


@pytest.mark.parametrize("file", FOREIGN)
def test_a_page_names_no_model_outside_the_folder_of_the_scene(address, documents, folder, scene, file):
    for name in (file, str(folder.parent / "outside.stl")):
        scene["grab"] = mesh(name)
        found = refused(address, scene, "/api/toml")
        assert found["key"] == "grab.file"
        assert "root:" not in found["error"]
    # Neither by its digest, though this process knows its content.
    known = simgrab.model.scenario.Mesh.of(folder.parent / "outside.stl")
    scene["grab"] = mesh(known.file) | {"sha256": known.sha256}
    assert refused(address, scene, "/api/toml")["key"] == "grab.file"
    scene["vary"] = {"grab": {"dist": "one-of", "values": [mesh(file)]}}
    scene["grab"] = documents.start.to_dict()["grab"]
    assert refused(address, scene, "/api/toml")["key"].startswith("vary.grab")


def test_a_model_below_the_folder_is_read_and_saved_by_its_path(documents, folder, scene):
    scene["grab"] = mesh("parts/box.stl")
    scenario = documents.parse(scene)
    again = documents.parse(scenario.to_dict())  # as the page sends it back: by name and digest
    assert again == scenario
    assert scenes.load(documents.save(scenario, "own.toml", replace=True)) == scenario
    assert 'file = "parts/box.stl"' in (folder / "own.toml").read_text()
    (folder / "elsewhere").mkdir(exist_ok=True)
    assert scenes.load(documents.save(scenario, "elsewhere/own.toml", replace=True)) == scenario
    assert 'file = "../parts/box.stl"' in (folder / "elsewhere" / "own.toml").read_text()
    assert documents.open("elsewhere/own.toml") == scenario
    started = Documents(folder / "own.toml", folder)
    assert started.parse(started.start.to_dict()) == started.start
    with pytest.raises(ScenarioError, match="of your own"):
        Documents("quay-day", folder).parse(scene)


def test_a_page_opens_no_scene_that_names_a_file_elsewhere(address, folder):
    scene = folder / "stranger.toml"
    for file in ("../outside.stl", "parts/link.stl", "/etc/passwd"):
        scene.write_text(SMALL + f'\n[grab]\nmodel = "mesh"\nfile = "{file}"\n', "utf-8")
        found = ask(address, "/api/open?scene=stranger.toml")
        assert found.status == 422
        assert "outside of" in found.json["error"]
    scene.write_text(SMALL + '\n[grab]\nmodel = "mesh"\nfile = "../outside.stl"\n', "utf-8")
    started = Documents(scene, folder)  # which the user names
    scene.unlink()
    assert started.start.grab.file == "outside.stl"
    assert 'file = "../outside.stl"' in started.toml(started.start)


@pytest.mark.parametrize("name", ["quay-day", "qingdao-twin", "hold-coal", "training"])
def test_bundled_scenes_are_written_and_read_back(name, tmp_path):
    documents = Documents(name, tmp_path)
    path = documents.save(documents.parse(json.loads(json.dumps(documents.start.to_dict()))), "again.toml")
    assert scenes.load(path) == documents.start
    line = commands.command(name, documents.start)
    assert line == f"simgrab render {name}"


def test_the_command_makes_the_same_scene():
    changes = {"camera.beta_deg": 5.0, "place": {"model": "hold", "cargo": "grain"}, "grab.paint_rgb": [0.1, 0.2, 0.3],
               "name": "a-b", "description": f'{HOSTILE} "\' $(x) \\ é', "clip.clip_frames": 8,
               "vary": {"light.sky": {"dist": "uniform", "low": 0.5, "high": 0.9}}}  # fmt: skip
    wanted = scenes.load("quay-day", changes)
    line = commands.command("quay-day", wanted)
    words = subprocess.run(["sh", "-c", f'printf "%s\\n" {line}'], capture_output=True, text=True, check=True)
    given = words.stdout.splitlines()
    assert given[:3] == ["simgrab", "render", "quay-day"]
    assert set(given[3::2]) == {"--set"}
    assert scenes.load("quay-day", scenes.parse_changes(given[4::2])) == wanted
    # What --set cannot do: remove a key, and set one that varies.
    assert commands.command("fog", scenes.load("quay-day")) is None
    training = scenes.load("training")
    assert commands.command("training", msgspec.structs.replace(training, vary={})) is None


def test_the_instrument_measures_from_the_file_alone(address, scene, monkeypatch):
    monkeypatch.setattr(measuring, "MOST_FRAMES", 2)
    scene |= {"frames": 2}
    found = post(address, "/api/measure", {"scene": scene, "frame": 1}).json
    assert (found["measured"], found["wanted"]) == (1, 2)
    assert found["alpha_deg"] is None
    assert "frames" in found["reason"]  # one is too few for a tilt
    found = post(address, "/api/measure", {"scene": scene, "frame": 1}).json
    assert found["measured"] == 2
    about, _ = frame(address, scene, 1)
    assert found["box"] == pytest.approx(about["truth"]["box"], abs=6)
    assert post(address, "/api/measure", {"scene": scene, "frame": 2}).status == 404


def test_records_stay_within_a_clip():
    scenario = scenes.load("work-cycles", {"frames": 900, "clip.clip_frames": 300})
    taken = measuring.record_of(scenario, 450)
    assert taken[0] == 300
    assert taken[-1] < 600
    assert len(taken) == measuring.MOST_FRAMES


def test_the_latest_wish_of_an_asker_wins_and_ranks_go_first():
    began, goes_on, done = threading.Event(), threading.Event(), []
    turns = Turns(lambda: done.append("last"))
    running = turns.ask("a", lambda: (began.set(), goes_on.wait(10)))
    began.wait(10)
    stale = turns.ask("a", lambda: done.append("stale"))
    low = turns.ask("record", lambda: done.append("record"), rank=1)
    newest = turns.ask("a", lambda: done.append("newest"))
    with pytest.raises(SupersededError):
        stale.result(10)
    goes_on.set()
    for future in (running, newest, low):
        future.result(10)
    failing = turns.ask("a", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        failing.result(10)
    turns.end()
    assert done == ["newest", "record", "last"]
    with pytest.raises(SupersededError):
        turns.ask("a", lambda: 1).result(10)
