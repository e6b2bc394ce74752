"""Datasets of shards: the same bytes wherever they lie, however they are made, and whatever fails meanwhile."""

import contextlib
import dataclasses
import os
import shutil
import warnings

import msgspec
import numpy as np
import pytest
from test_dataset import stopping

import simgrab
from simgrab.dataset import datasets, shard_reader, shards
from simgrab.dataset.export import export
from simgrab.dataset.render import render
from simgrab.errors import DatasetError, ScenarioError
from simgrab.io import stores
from simgrab.io.journal import Journal
from tests.conftest import SMALL
from tests.s3_server import BUCKET, contents, folder_contents, s3

THIRDS = {"train": 0.4, "val": 0.3, "test": 0.3}
FRAMES = {"frames": 11, "seed": 3, "splits": THIRDS, "swing.absent": 0.2}


@pytest.fixture(scope="module")
def scene():
    return simgrab.load("quay-day", SMALL | FRAMES)


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """A folder of shards, made in one go by one process."""
    path = tmp_path_factory.mktemp("shards") / "whole"
    render(scene, path.as_uri(), shard_frames=4)
    return path


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("shards") / "folder"
    render(scene, path)
    return path


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr(stores, "_FIRST_PAUSE_S", 0.01)
    with s3(monkeypatch) as app:
        yield app


def test_shards_hold_what_a_folder_holds(whole, folder):
    ours, theirs = simgrab.open(whole.as_uri()), simgrab.open(folder)
    assert (len(ours), ours.splits, ours.scenario, ours.calibration) == (
        len(theirs), theirs.splits, theirs.scenario, theirs.calibration,
    )  # fmt: skip
    assert ours.data.frames == theirs.data.frames == 11
    for a, b in zip(ours, theirs, strict=True):
        assert (a.truth, a.labelled, a.content, a.file) == (b.truth, b.labelled, b.content, None)
        np.testing.assert_array_equal(a.picture, b.picture)
        np.testing.assert_array_equal(a.mask, b.mask)
    for split in ("train", "val", "test"):
        part, known = ours.split(split), [frame.truth for frame in theirs.split(split)]
        assert [frame.truth for frame in part] == [part[i].truth for i in range(len(part))] == known
        assert [frame.truth for frame in part[1::2]] == known[1::2]
        assert [frame.truth for frame in part[::-1]] == known[::-1]
    assert simgrab.open(whole) == ours  # by its path, too
    assert ours.frame(7).truth == theirs.frame(7).truth
    assert ours[-1].content == theirs[-1].content


@pytest.mark.parametrize("number", [-1, 11, 10**12])
def test_a_frame_that_is_not_there_is_refused(whole, number):
    data = simgrab.open(whole)
    with pytest.raises(KeyError, match=str(number)):
        data.frame(number)
    if number > 0:
        with pytest.raises(IndexError, match="out of range of 11 frames"):
            data[number]
    with pytest.raises(KeyError, match="no split"):
        data.split("dev")
    with pytest.raises(ValueError, match="whole dataset"):
        data[:3].split("train")
    assert 0 not in [frame.truth.frame for frame in data[1:]]
    with pytest.raises(KeyError):
        data[1:].frame(0)


def test_an_interrupted_run_goes_on_with_the_same_bytes(scene, whole, tmp_path):
    out = tmp_path / "again"
    with pytest.raises(KeyboardInterrupt):
        render(scene, out.as_uri(), shard_frames=4, progress=stopping(6))
    known = folder_contents(whole)
    assert all(known[name] == data for name, data in folder_contents(out).items() if name != "unfinished.json")
    with pytest.raises(DatasetError, match="unfinished; continue with simgrab render --resume"):
        simgrab.open(out.as_uri())
    with pytest.raises(DatasetError, match="an unfinished dataset; continue with --resume"):
        render(scene, out.as_uri(), shard_frames=4)
    with pytest.raises(DatasetError, match=r"another dataset \(its shard_frames differs\)"):
        render(scene, out.as_uri(), shard_frames=5, resume=True)
    assert render(scene, out.as_uri(), shard_frames=4, resume=True).made == 7
    assert folder_contents(out) == known
    assert render(scene, out.as_uri(), shard_frames=4, resume=True).made == 0
    with pytest.raises(DatasetError, match="a finished dataset"):
        render(scene, out.as_uri(), shard_frames=4)


def test_a_shard_that_lost_an_archive_is_made_again(scene, whole, tmp_path):
    out = tmp_path / "lost"
    with pytest.raises(ZeroDivisionError):
        render(scene, out.as_uri(), shard_frames=4, progress=lambda done, _total: 1 // (11 - done))
    next((out / "shards").glob("*-000000.tar")).unlink()
    assert render(scene, out.as_uri(), shard_frames=4, resume=True).made == 7
    assert folder_contents(out) == folder_contents(whole)


def test_a_place_that_vanishes_gets_no_manifest(scene, tmp_path, monkeypatch):
    """As where a file system is unmounted: what is written from then on lies below the same name, elsewhere."""
    out, other = tmp_path / "set", tmp_path / "other"

    def vanish(done, _total):
        if done == 6:
            out.rename(tmp_path / "gone")

    with pytest.raises(DatasetError, match="it is not there"):
        render(scene, out.as_uri(), shard_frames=4, progress=vanish)
    assert not (out / "manifest.json").exists()

    def lose(done, _total):
        if done == 6:
            (other / "labels/000000.parquet").unlink()

    with pytest.raises(DatasetError, match=r"labels/000000\.parquet is gone; run it again with --resume"):
        render(scene, other.as_uri(), shard_frames=4, progress=lose)
    assert render(scene, other.as_uri(), shard_frames=4, resume=True).made == 4
    monkeypatch.setattr(Journal, "opened", contextlib.nullcontext)
    with pytest.raises(DatasetError, match=r"was removed or finished by another process; it has no unfinished\.json"):
        render(scene, (tmp_path / "unclaimed").as_uri(), shard_frames=4)


@pytest.mark.parametrize(("wanted", "expected"), [(None, 256), (1, 8), (8, 8), (9, 16)])
def test_worlds_that_vary_stay_whole(wanted, expected):
    scene = simgrab.load("training", {"frames": 2000})
    assert shards.frames_of(scene, wanted, varies=True) == expected
    assert shards.frames_of(scene, 2**60, varies=True) == 2000
    assert shards.spans(simgrab.load("training", {"frames": 20}), 8) == [range(8), range(8, 16), range(16, 20)]
    assert shards.frames_of(scene, wanted, varies=False) == (wanted or 256)


def test_a_place_that_holds_something_else_is_refused(scene, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match="something other than a simgrab dataset"):
        render(scene, tmp_path.as_uri())
    (tmp_path / "notes.txt").rename(tmp_path / "unfinished.json")
    with pytest.raises(DatasetError, match=r"unfinished\.json: it is not valid JSON"):
        render(scene, tmp_path.as_uri(), resume=True)
    assert [path.name for path in tmp_path.iterdir()] == ["unfinished.json"]


@pytest.mark.parametrize(
    ("out", "options", "why"),
    [
        ("nope://x/y", {}, "nope"),
        ("file:///proc/x", {}, "/proc/x"),
        ("file:///tmp/x", {"shard_frames": 0}, "1 frame or more"),
        ("file:///tmp/x", {"video": "x.mp4"}, "give neither cluster nor URL"),
        ("folder", {"shard_frames": 5}, "a folder; shards need a URL such as file:///"),
        *((url, {}, "cannot be used") for url in ("file://", "file:///", "file://host/x", "s3://")),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(scene, tmp_path, monkeypatch, out, options, why):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DatasetError, match=why) as problem:
        render(scene, out, **options)
    assert "\n" not in str(problem.value)
    assert list(tmp_path.iterdir()) == []


def test_an_impossible_scene_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ScenarioError):
        render(simgrab.load("quay-day", SMALL | {"camera.beta_deg": 60.0}), (tmp_path / "new").as_uri())
    assert list(tmp_path.iterdir()) == []


def damaged(whole, out, name, change):
    shutil.copytree(whole, out)
    (out / name).write_bytes(change((out / name).read_bytes()))
    return out


def test_damage_is_seen(whole, tmp_path):
    frame = simgrab.open(whole)[0]
    place = shard_reader.parse_shard((whole / "labels/000000.parquet").read_bytes(), "").places[0]
    flipped = bytes([frame.content[100] ^ 1])

    def flip(data):
        at = place.offset + 100
        return data[:at] + flipped + data[at + 1 :]

    data = simgrab.open(damaged(whole, tmp_path / "a", place.shard, flip))
    for picture in (lambda: data[0].picture, lambda: next(iter(data)).picture):
        with pytest.raises(DatasetError, match="does not match the digest"):
            picture()
    data = simgrab.open(damaged(whole, tmp_path / "b", place.shard, lambda data: data[:700]))
    with pytest.raises(DatasetError, match="cut off"):
        _ = data[0].picture
    data = simgrab.open(damaged(whole, tmp_path / "c", "labels/000000.parquet", lambda data: data + b" "))
    with pytest.raises(DatasetError, match="does not match the digest in the manifest"):
        data[0]
    for change in (lambda _: b"{}", lambda _: b"[1]", lambda data: data[:99]):
        with pytest.raises(DatasetError, match=r"manifest|not a simgrab dataset"):
            simgrab.open(damaged(whole, tmp_path / f"d{change(b'')}", "manifest.json", change).as_uri())


def test_a_manifest_is_not_read_beyond_its_limit(whole, monkeypatch):
    monkeypatch.setattr(datasets, "MOST_MANIFEST_BYTES", 1000)
    with pytest.raises(DatasetError, match="the limit is 1000"):
        simgrab.open(whole)


def test_a_place_outside_of_the_dataset_is_refused():
    for shard in ("../secret.tar", "shards/train-000000.tar/../../x", "/etc/passwd", "shards/dev-000000.tar"):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({"shard": shard, "offset": 0, "size": 1, "mask": None}, shard_reader.Place)


def test_an_s3_store_gets_the_same_bytes_from_any_number_of_workers(scene, whole, server):
    assert server.writes
    url = f"s3://{BUCKET}/plain/set"
    render(scene, url, shard_frames=4, workers=2)
    assert contents("plain/set") == folder_contents(whole)
    data = simgrab.open(url)
    assert [f.content for f in data] == [f.content for f in simgrab.open(whole)]
    assert data[3].picture.any()


@pytest.mark.parametrize("fault", ["errors_every", "cut_every", pytest.param("lost_every", marks=pytest.mark.slow)])
def test_faults_of_the_store_are_overcome(scene, whole, server, fault):
    setattr(server, fault, 3)
    render(scene, f"s3://{BUCKET}/{fault}", shard_frames=4)
    setattr(server, fault, 0)
    assert server.writes > len(folder_contents(whole))
    assert contents(fault) == folder_contents(whole)


def test_a_store_that_fails_for_good_leaves_what_can_be_resumed(scene, whole, server):
    url, known = f"s3://{BUCKET}/dead", folder_contents(whole)
    server.dead_after = server.writes + 4
    with pytest.raises(DatasetError, match="cannot write") as problem:
        render(scene, url, shard_frames=4)
    assert "\n" not in str(problem.value)
    server.dead_after = None
    left = contents("dead")
    assert 0 < len(left) < len(known)
    assert all(known[name] == data for name, data in left.items() if name != "unfinished.json")  # none is half there
    render(scene, url, shard_frames=4, resume=True)
    assert contents("dead") == known


def test_a_store_that_is_not_there_is_one_line(scene, server, monkeypatch):
    with pytest.raises(DatasetError, match="not a dataset"):
        simgrab.open(f"s3://{BUCKET}/nothing")
    with pytest.raises(DatasetError, match="no-such-bucket") as problem:
        render(scene, "s3://no-such-bucket/x", shard_frames=4)
    assert "\n" not in str(problem.value)
    assert server.writes
    monkeypatch.setattr(stores, "ATTEMPTS", 1)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(DatasetError, match=r"cannot .* s3://frames/x") as problem:
        render(scene, f"s3://{BUCKET}/x", shard_frames=4)
    assert "\n" not in str(problem.value)


def test_requests_that_read_are_repeated(whole, server):
    url = f"s3://{BUCKET}/read"
    for name, data in folder_contents(whole).items():
        stores.Store(url).write(name, data)
    server.reads_fail = 1
    assert stores.Store(url).exists("manifest.json")
    data = simgrab.open(url)
    server.reads_fail = 1
    assert data[0].content == simgrab.open(whole)[0].content


def test_a_store_can_be_used_after_a_fork(whole, server):
    """As by the processes of a DataLoader."""
    url = f"s3://{BUCKET}/fork"
    for name, data in folder_contents(whole).items():
        stores.Store(url).write(name, data)
    data = simgrab.open(url)
    known = data[5].content
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads, from Python 3.12 on
        child = os.fork()
    if child == 0:
        status = 1
        try:
            status = int(data[5].content != known)
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert server.writes


def test_any_name_of_a_folder_is_a_url(scene, tmp_path):
    two, known = msgspec.structs.replace(scene, frames=2), None
    for name in ("plain", "with space", "a%20b#c?d", "ü雪", "a::b", os.fsdecode(b"\xff")):
        out = tmp_path / name
        render(two, out.as_uri(), shard_frames=1)
        known = known or folder_contents(out)
        assert folder_contents(out) == known
        assert len(simgrab.open(out)) == 2
        export(out, out.with_name(f"{name} yolo"), format="yolo")
        assert (out.with_name(f"{name} yolo") / "manifest.json").exists()
        assert len(list(tmp_path.iterdir())) == 2
        for path in list(tmp_path.iterdir()):
            shutil.rmtree(path)


def labels_cut_off(out):
    os.truncate(out / "labels/000002.parquet", 100)
    (out / "manifest.json").rename(out / "unfinished.json")


@pytest.mark.parametrize(
    ("damage", "made"),
    [
        (lambda out: (out / "labels/000001.parquet").unlink(), 4),
        (lambda out: next((out / "shards").glob("*-000000.tar")).unlink(), 4),
        (lambda out: shutil.copy(out / "manifest.json", out / "unfinished.json"), 0),  # a claim
        (labels_cut_off, 3),
    ],
)
def test_what_is_lost_damaged_or_left_after_the_end_is_put_right(scene, whole, tmp_path, damage, made):
    out = shutil.copytree(whole, tmp_path / "set")
    damage(out)
    assert render(scene, out.as_uri(), shard_frames=4, resume=True).made == made
    assert folder_contents(out) == folder_contents(whole)


def test_shards_of_two_renderers_are_never_finished(scene, whole, tmp_path, monkeypatch):
    out = shutil.copytree(whole, tmp_path / "set")
    (out / "labels/000001.parquet").unlink()
    write = shards.write

    def elsewhere(store, number, made, scenario, rendered_by):
        return write(store, number, made, scenario, dataclasses.replace(rendered_by, renderer="another"))

    monkeypatch.setattr(shards, "write", elsewhere)
    for _ in range(2):
        with pytest.raises(DatasetError, match="was started with"):
            render(scene, out.as_uri(), shard_frames=4, resume=True)
        (out / "labels/000001.parquet").unlink()  # which this renderer wrote
        assert not (out / "manifest.json").exists()


def test_pictures_are_read_when_they_are_asked_for(whole, monkeypatch):
    reads = []
    read = stores.Store.read
    monkeypatch.setattr(
        stores.Store, "read", lambda self, name, **options: reads.append(name) or read(self, name, **options)
    )
    data = simgrab.open(whole)
    frames = list(data)
    assert not [name for name in reads if name.startswith("shards")]
    assert all(frame.content for frame in frames)
    assert len([name for name in reads if name.startswith("shards")]) == len(list((whole / "shards").iterdir()))
    assert frames[3].content == data[3].content
