"""What `simgrab browse` answers about a dataset or a run, and that it leaves them as they are."""

import base64
import itertools
import json
import shutil
from dataclasses import dataclass
from urllib.parse import quote

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import altered
from films import film, picture
from http_requests import ask
from hypothesis import given, settings
from hypothesis import strategies as st

import simgrab
from simgrab.errors import DatasetError, SimgrabError
from simgrab.instrument.contract import Measurement
from simgrab.instrument.run import runs
from simgrab.instrument.source import open_source
from simgrab.instrument.video import Video
from simgrab.io import pictures
from simgrab.io.files import sha256
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.model.masks import Coded
from simgrab.pages.browse import browse, columns, dataset
from simgrab.pages.browse.exporting import Exports
from simgrab.pages.browse.pictures import LruCache
from simgrab.pages.browse.run import _in_folder
from simgrab.pages.browse.videos import VideoPictures

HOSTILE = "<script>document.title=1<b>"


def state(folder):
    """Everything in a folder: names, contents and times."""
    return {
        str(path.relative_to(folder)): (path.stat().st_mtime_ns, sha256(path) if path.is_file() else "")
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture(scope="module")
def data(split_dataset, tmp_path_factory):
    """A dataset in a folder with a hostile name."""
    return shutil.copytree(split_dataset, tmp_path_factory.mktemp("browse") / HOSTILE)


@pytest.fixture(scope="module")
def labels(data):
    return pd.read_parquet(data / "labels.parquet")


@pytest.fixture(scope="module")
def address(data):
    before = state(data)
    with browse.serving(browse.open(data)) as address:
        yield address
    assert state(data) == before


@pytest.fixture(scope="module")
def summary(address):
    return ask(address, "/api/summary").json


@dataclass
class Erring:
    """An instrument that errs more from frame to frame, by turns to both sides, and misses the third."""

    truth: dict
    name: str = "erring"

    def __call__(self, frames, calibration):  # noqa: ARG002
        for i, frame in enumerate(frames):
            alpha = np.radians(self.truth[frame.name].alpha_deg + 0.1 * i * (-1) ** i)
            missed = Measurement(status="missed", reason=HOSTILE)
            yield missed if i == 2 else Measurement(status="ok", alpha=abs(alpha), centre=(5.0, 6.0))


@pytest.fixture(scope="module")
def ran(data, tmp_path_factory):
    run = simgrab.run(data, instrument=Erring({row.file: row for row in simgrab.open(data).rows}))
    folder = tmp_path_factory.mktemp("run") / "run"
    folder.mkdir()
    runs.save(run, folder)
    return folder


def column(address, summary, name):
    index = [one["name"] for one in summary["columns"]].index(name)
    about, body = summary["columns"][index], ask(address, f"/api/columns/{index}").body
    return about, np.frombuffer(body, "<f8" if about["kind"] == "number" else "<u4")


def test_columns_are_those_of_the_labels(address, summary, labels):
    assert [one["name"] for one in summary["columns"]][: len(labels.columns)] == list(labels.columns)
    assert summary["rows"] == len(labels)
    kinds = set()
    for name in labels.columns:
        about = next(one for one in summary["columns"] if one["name"] == name)
        kinds.add(about["kind"])
        if about["kind"] == "list":
            continue
        values = column(address, summary, name)[1]
        if about["kind"] == "number":
            np.testing.assert_array_equal(values, labels[name].astype(float))
        elif about["kind"] == "category":
            known = [None if pd.isna(value) else value for value in labels[name].tolist()]
            yes = {True: "yes", False: "no"}
            assert [about["levels"][code] for code in values] == [yes.get(value, value) for value in known]
        else:
            assert labels[name].to_numpy()[np.argsort(values)].tolist() == sorted(labels[name])
    assert kinds == {"number", "category", "text", "list"}


@settings(max_examples=40)
@given(st.lists(st.none() | st.text(max_size=3), min_size=1, max_size=60))
def test_codes_sort_as_texts_do(texts):
    made = columns.column("a", pa.chunked_array([pa.array(texts, pa.string())]))
    order = np.argsort(made.codes, kind="stable").tolist()
    assert [texts[i] for i in order] == sorted(texts, key=lambda text: (text is None, text or ""))
    if made.kind == "category":
        assert [made.levels[code] for code in made.codes] == texts


@given(
    st.lists(st.text(alphabet="aAbB.*(", max_size=4), min_size=1, max_size=30), st.text(alphabet="aAbB.*(", max_size=2)
)
def test_a_text_is_found_as_it_is_written(texts, part):
    made = columns.column("a", pa.chunked_array([pa.array(texts, pa.string())]))
    assert made.matches(part).tolist() == [part.lower() in text.lower() for text in texts]


def test_a_column_of_texts_is_searched(address, summary, labels):
    index = [one["name"] for one in summary["columns"]].index("file")
    bits = np.frombuffer(ask(address, f"/api/columns/{index}/matches?text=TRAIN%2F").body, np.uint8)
    found = np.unpackbits(bits, count=len(labels), bitorder="little")
    np.testing.assert_array_equal(found, labels["file"].str.contains("train/"))


def test_factors_become_columns():
    full = ['{"weather": "fog", "camera.beta_deg": 1.5}', '{"camera.beta_deg": 2, "list": [1]}']
    texts = [*full, "", "no JSON", None, "[1]"]
    found = dict(columns.expanded(pa.chunked_array([pa.array(texts, pa.string())]), "v."))
    assert {name: values.to_pylist() for name, values in found.items()} == {
        "v.camera.beta_deg": [1.5, 2.0, None, None, None, None],
        "v.list": [None, "[1]", None, None, None, None],
        "v.weather": ["fog", None, None, None, None, None],
    }
    hostile = [f'{{"a": 1{"0" * 400}}}', '{"a": 9007199254740993, "\\ud800": "\\udfff"}']  # of no float, of no text
    found = dict(columns.expanded(pa.chunked_array([hostile]), "v."))
    assert {name: values.to_pylist() for name, values in found.items()} == {
        "v.a": [np.inf, 2.0**53], r"v.\ud800": [None, r"\udfff"],
    }  # fmt: skip


def test_weather_place_and_grab_are_shown_first():
    names = ["varied.grab", "varied.grab.arms", "varied.light+weather", "varied.weather.wind_m_s", "weather"]
    table = pa.table({name: [1] for name in names})
    assert dataset.factors(table) == ["varied.light+weather", "varied.grab"]
    assert dataset.factors(table.rename_columns([f"true_{name}" for name in names]), "true_") == [
        "true_varied.light+weather",
        "true_varied.grab",
    ]


def test_a_frame_is_shown_with_its_labels_and_its_picture(address, summary, data):
    source = simgrab.open(data)
    drawn = ask(address, "/api/overlays?masks=1&rows=" + ",".join(map(str, range(len(source))))).json
    for row, (frame, one) in enumerate(zip(source, drawn, strict=True)):
        assert (one["row"], one["frame"], one["width"]) == (row, frame.truth.frame, frame.truth.width_px)
        assert one["truth"]["box"] == (None if frame.box is None else frame.box.tolist())
        points = [point for point in frame.keypoints.tolist() if point[2]]
        assert [point[1:] for point in one["truth"]["keypoints"]] == points
        assert (one["truth"]["mask"] is None) == (frame.mask is None)
        if frame.mask is not None:
            us = [u for polygon in one["truth"]["mask"] for u in polygon[::2]]
            assert min(us) == pytest.approx(frame.box[0], abs=3)
            assert max(us) == pytest.approx(frame.box[2], abs=3)
        answer = ask(address, f"/api/frames/{row}/picture")
        assert answer.body == frame.content
        assert answer.headers["content-type"] == "image/jpeg"
        small = pictures.decode(ask(address, f"/api/frames/{row}/tile").body, "tile")
        assert small.shape == (180, 320, 3)
        values = ask(address, f"/api/frames/{row}").json["values"]
        known = dict(zip((one["name"] for one in summary["columns"]), values, strict=True))
        assert known["alpha_deg"] == frame.truth.alpha_deg
        assert known["keypoints"] == list(frame.truth.keypoints)
        assert known["labelled"] == frame.labelled


@pytest.mark.parametrize(
    "row", ["-1", "12", "999999999999999999999", "1e0", "0x1", "٣", "", "0/../../labels.parquet", "..%2f"]
)
@pytest.mark.parametrize("what", ["", "/tile", "/picture"])
def test_frames_are_named_by_numbers_alone(address, row, what):
    answer = ask(address, f"/api/frames/{quote(row, safe='/%.')}{what}")
    assert answer.status in (404, 405)


@pytest.mark.parametrize(
    "path",
    ["/static/../app.py", "/static/..%2fapp.py", "/static/%2e%2e/app.py", "/static//etc/passwd", "/../../../etc/passwd",
     "/static/..\\app.py", "/static/index.html%00", "/labels.parquet", "/static/", "//etc/passwd"],
)  # fmt: skip
def test_no_path_leads_to_a_file(address, path):
    answer = ask(address, path)
    assert answer.status == 404
    assert b"Browser" not in answer.body
    assert b"root:" not in answer.body


def test_the_page_itself_holds_no_name(address, data):
    for path in ("/", "/static/main.js"):
        body = ask(address, path).body
        assert data.name.encode() not in body
    answer = ask(address, "/api/summary")
    assert answer.headers["content-type"] == "application/json"  # which a browser shows as text
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.json["name"] == str(data)


def selection(rows, count):
    bits = np.zeros(count, bool)
    bits[list(rows)] = True
    return base64.b64encode(np.packbits(bits, bitorder="little").tobytes()).decode()


def export(address, body, **headers):
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    answer = ask(address, "/api/export", "POST", body=data, headers=headers)
    while answer.status == 200 and answer.json["status"] == "running":
        answer = ask(address, "/api/export")
    return answer


def test_a_selection_is_exported_as_a_dataset(address, data, tmp_path):
    source, chosen = simgrab.open(data), [9, 0, 4]
    body = {"rows": selection(chosen, len(source)), "out": str(tmp_path / "out"), "format": "simgrab"}
    assert export(address, body).json["status"] == "done"
    made = simgrab.open(tmp_path / "out")
    assert [frame.truth for frame in made] == [source[i].truth for i in sorted(chosen)]
    assert [frame.content for frame in made] == [source[i].content for i in sorted(chosen)]
    for frame, i in zip(made, sorted(chosen), strict=True):
        np.testing.assert_array_equal(frame.mask, source[i].mask)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_bytes())
    assert manifest["frames"] == 3
    assert manifest["selection"] == {"of_frames": 12, "labels_sha256": source.data.labels_sha256}
    with browse.serving(browse.open(tmp_path / "out")) as again:
        assert ask(again, "/api/summary").json["rows"] == 3


def test_nothing_is_exported_into_what_is_browsed(address, data, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(data)
    (tmp_path / "taken").mkdir()
    good = {"rows": selection([1], 12), "out": str(tmp_path / "out"), "format": "yolo"}
    inside = (data, data / "new", link / "new", data / "images" / ".." / "a" / "b")
    for place in (*inside, tmp_path / "taken", "s3://a/b", "", "~nobody-of-this-name/a", "a\0b"):
        answer = export(address, good | {"out": str(place)})
        assert answer.status == 422
        assert answer.json["error"].isprintable()
    for bad in (
        good | {"rows": ""}, good | {"rows": "AAAAAAAA"}, good | {"rows": "?"}, good | {"more": 1}, b"{", b"\xff", [],
        good | {"out": 3},
    ):  # fmt: skip
        assert export(address, bad).status == 400
    for bad in (good | {"rows": selection([], 12)}, good | {"format": "webdataset"}):
        assert export(address, bad).status == 422
    assert export(address, good, Origin="http://evil.example").status == 403
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "taken"]


def test_an_export_that_the_end_cuts_short_leaves_nothing(data, tmp_path):
    exports = Exports(browse.open(data))
    exports.end()
    exports.start(np.arange(12), str(tmp_path / "out"), "yolo")
    exports.end()
    assert exports.state.status == "running"
    assert list(tmp_path.iterdir()) == []


def test_a_picture_outside_of_the_dataset_is_not_shown(data, tmp_path):
    path = shutil.copytree(data, tmp_path / "copy")
    (tmp_path / "secret.jpg").write_bytes((data / simgrab.open(data).rows[0].file).read_bytes()[:-9] + b"secret\0\0\0")
    files = [row.file for row in simgrab.open(data).rows]
    files[:2] = ["../secret.jpg", str(tmp_path / "secret.jpg")]
    files[2] = "images/<img src=x>.jpg"
    (path / files[3]).unlink()
    (path / files[3]).symlink_to(tmp_path / "secret.jpg")
    (path / files[4]).write_bytes(b"\xff\xd8 changed")
    altered(path, "file", lambda _: files)
    subject = browse.open(path)
    assert "digest" in subject.notes[0]
    with browse.serving(subject) as address:
        for row, what in itertools.product(range(5), ("tile", "picture")):
            answer = ask(address, f"/api/frames/{row}/{what}")
            assert answer.status == 422
            assert b"secret\0" not in answer.body
        assert ask(address, "/api/frames/5/tile").status == 200


def test_a_run_shows_its_largest_errors_first(ran, data):
    before = state(ran), state(data)
    subject = browse.open(ran)
    assert (subject.order.column, subject.order.descending) == ("abs_error_deg", True)
    errors = subject.table["abs_error_deg"].to_numpy()
    present = np.array([row.present for row in simgrab.open(data).rows])
    alpha = np.array([row.alpha_deg for row in simgrab.open(data).rows])
    measured = np.abs(alpha + 0.1 * np.arange(12) * (-1.0) ** np.arange(12))
    wanted = np.where(present & (np.arange(12) != 2), measured - alpha, np.nan)
    np.testing.assert_allclose(errors, np.abs(wanted), atol=1e-9)
    assert np.nanmax(errors) == pytest.approx(evaluate(ran, data).angle.overall.max_deg)
    with browse.serving(subject) as address:
        summary = ask(address, "/api/summary").json
        assert summary["kind"] == "run"
        _, sent = column(address, summary, "error_deg")
        np.testing.assert_allclose(sent, wanted, atol=1e-9)
        about, codes = column(address, summary, "reason")
        assert about["levels"][codes[2]] == HOSTILE
        drawn = ask(address, "/api/overlays?rows=1,2").json
        assert [one["measured"]["centre"] for one in drawn] == [[5.0, 6.0], None]
        assert drawn[0]["truth"]["box"] == list(simgrab.open(data)[1].box)
        assert ask(address, "/api/frames/3/picture").body == simgrab.open(data)[3].content
    assert (state(ran), state(data)) == before


def test_a_run_without_its_source_shows_what_it_measured(ran, tmp_path):
    path = shutil.copytree(ran, tmp_path / "run")
    about = json.loads((path / "run.json").read_bytes())
    (path / "run.json").write_text(json.dumps(about | {"labels_sha256": "0" * 64}), encoding="utf-8")
    subject = browse.open(path)  # another dataset lies at the place that it names
    assert subject.order.column == "frame"
    assert "--source" in subject.notes[0]
    with browse.serving(subject) as address:
        assert ask(address, "/api/frames/0/tile").status == 422
        wanted = {"rows": selection([1], 12), "out": str(tmp_path / "x"), "format": "yolo"}
        assert export(address, wanted).status == 422
    with pytest.raises(SimgrabError, match="does not belong to this run"):
        browse.open(path, about["source"])


def test_pictures_of_a_video_are_those_of_their_times(tmp_path):
    times = [i / 9 for i in range(23)]
    path = film(tmp_path / "a.mp4", times)
    expected = [frame.picture.mean() for frame in Video(path)]
    found = VideoPictures(path, times)
    for row in (17, 3, 22, 0, 4, 17, 21):
        assert pictures.decode(found.content(row), "frame").mean() == pytest.approx(expected[row], abs=0.8)
    assert [frame.picture.mean() for frame in Video(path).from_time(times[13])][-10:] == expected[-10:]
    with pytest.raises(SimgrabError, match="no image at 99"):
        VideoPictures(path, [99.0]).content(0)


def test_pictures_of_a_video_without_time_stamps_are_those_of_the_rate_it_was_measured_at(tmp_path):
    jpegs = (cv2.imencode(".jpg", picture(i))[1].tobytes() for i in range(12))
    (tmp_path / "a.mjpeg").write_bytes(b"".join(jpegs))
    found = VideoPictures(tmp_path / "a.mjpeg", [i / 20 for i in range(12)])
    levels = [pictures.decode(found.content(row), "frame").mean() for row in (11, 0, 5)]
    assert levels == pytest.approx([picture(row).mean() for row in (11, 0, 5)], abs=1)


def test_pictures_of_fewer_bits_are_shown_as_they_were_measured(tmp_path):
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture(i).astype(np.uint16) << 4)
    source = open_source(tmp_path)
    found = pictures.decode(_in_folder(source, ("0.png", "1.png", "2.png"))(1), "frame")
    np.testing.assert_array_equal(found, list(source)[1].picture)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 120)), max_size=40))
def test_what_is_kept_is_limited(puts):
    kept, last = LruCache(300), {}
    for key, size in puts:
        kept.put(key, bytes(size))
        last[key] = size
        assert kept.size_bytes <= 300
        assert kept.get(key) == bytes(size)
    held = {key: len(data) for key in last if (data := kept.get(key)) is not None}
    assert sum(held.values()) == kept.size_bytes
    assert held == {key: last[key] for key in held}


def test_an_unfinished_dataset_shows_what_is_there(data, tmp_path):
    path = shutil.copytree(data, tmp_path / "data")
    rows = path / ".partial" / "rows"
    rows.mkdir(parents=True)
    manifest = json.loads((path / "manifest.json").read_bytes())
    identity = path / ".partial" / "identity.json"
    (path / "manifest.json").unlink()
    for frames, problem in (("1e999", "not an unfinished simgrab dataset"), ("12", "no frame of it is there")):
        identity.write_text(json.dumps(manifest | {"frames": "N"}).replace('"N"', frames), encoding="utf-8")
        with pytest.raises(DatasetError, match=problem):
            browse.open(path)
    source = simgrab.open(data)
    for frame in source[:4]:
        row = {key: getattr(frame.truth, key) for key in frame.truth.__struct_fields__}
        coded = frame.coded_mask or Coded((270, 480), "")
        mask = {"size": coded.size, "counts": coded.counts}
        record = {"truth": row, "mask": mask, "rendered_by": manifest["renderer"]}
        (rows / f"{frame.truth.frame:08d}.json").write_text(json.dumps(record), encoding="utf-8")
    (rows / "00000005.json").write_text("{", encoding="utf-8")
    subject = browse.open(path)
    assert subject.notes == (
        "unfinished: 4 of 12 frames of quay-day are there; simgrab render --resume goes on",
        "1 records are damaged and not shown",
    )
    with browse.serving(subject) as address:
        assert ask(address, "/api/frames/2/picture").body == source[2].content
        seen = next(i for i, frame in enumerate(source[:4]) if frame.labelled)
        assert ask(address, f"/api/overlays?rows={seen}&masks=1").json[0]["truth"]["mask"]
        assert ask(address, "/api/summary").json["formats"] == []


def test_what_cannot_be_browsed_is_named(data, tmp_path):
    def line(path, source=None):
        with pytest.raises(SimgrabError) as raised:
            browse.open(path, source)
        return str(raised.value)

    assert "there is no such folder" in line(tmp_path / "none")
    assert "it is a file" in line(data / "labels.parquet")
    assert "neither a dataset nor a run" in line(tmp_path)
    assert "--source is for the folder of simgrab run" in line(data, data)
    path = shutil.copytree(data, tmp_path / "copy")
    (path / "labels.parquet").write_bytes((data / "labels.parquet").read_bytes()[:5000])
    assert "not a parquet file that can be read" in line(path)
    table = pq.read_table(data / "labels.parquet")
    pq.write_table(table.drop_columns(["keypoints"]), path / "labels.parquet")
    assert "they lack keypoints" in line(path)
    pq.write_table(table.take([3, 1]), path / "labels.parquet")
    assert "frames must increase" in line(path)
    (path / "manifest.json").unlink()
    assert "it has no manifest.json" in line(path)
