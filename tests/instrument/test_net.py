"""Files that are made to harm: whatever a net is, it is refused in one line, or its outputs are bounded."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from nets import CELLS, constant_yolo, hand_made, info, number, rows, save, with_metadata

from simgrab.errors import DetectorError, ReaderError
from simgrab.instrument import net as nets
from simgrab.instrument import onnx_parts
from simgrab.instrument.deadline import within
from simgrab.instrument.detect import Yolo, detector
from simgrab.instrument.read import READER_WEIGHTS, Reader
from simgrab.instrument.read.reader import METADATA, reading
from simgrab.model import layouts

onnx = pytest.importorskip("onnx")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

PICTURE = np.zeros((64, 64, 3), np.uint8)
NODE = helper.make_node


def saved(path, nodes, weights=(), *, output=None, taken=(1, 3, 64, 64), domain="", metadata=None):
    """A net of one input, ``images``, and one output, ``output``."""
    outputs = [output or info("output", None)]
    return save(path, nodes, [info("images", taken)], outputs, weights, metadata=metadata, domain=domain)


def refusals(path):
    """What detector and reader say of a file: one line each, of what a terminal can show."""
    said = []
    for open_it, kind in ((detector, DetectorError), (Reader, ReaderError)):
        with pytest.raises(kind) as refused:
            open_it(path)
        said.append(str(refused.value))
        assert len(said[-1]) < 900
        assert said[-1].replace(str(path), "").isprintable()
    return said


# Other files -----------------------------------------------------------------------------------------------------


def elsewhere(location):
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[1], data_location=TensorProto.EXTERNAL)
    for key, value in {"location": location, "offset": "0", "length": "4"}.items():
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value
    return tensor


def in_constant(tensor):
    node = NODE("Constant", [], ["w"])
    node.attribute.add(name="value", type=onnx.AttributeProto.TENSOR).t.CopyFrom(tensor)
    return [node], []


def in_branch(tensor):
    then, other = (
        helper.make_graph([NODE("Identity", [name], [f"{name}2"])], "b", [], [info(f"{name}2", None)], [weight])
        for name, weight in (("w", tensor), ("v", number("v", [0.0])))
    )
    yes = number("yes", True, bool)
    return [NODE("If", ["yes"], ["w_"], then_branch=then, else_branch=other), NODE("Identity", ["w_"], ["w"])], [yes]


PLACES = {"weights": lambda tensor: ([], [tensor]), "constant": in_constant, "branch": in_branch}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("location", ["w.bin", "../w.bin", "link.bin", "/w.bin", "*/_ORT_MEM_ADDR_/*"])
def test_no_other_file_is_opened(tmp_path, monkeypatch, place, location):
    monkeypatch.chdir(tmp_path)  # which onnxruntime takes for the folder of a model that is given as bytes
    (tmp_path / "w.bin").write_bytes(b"\0" * 4)
    (tmp_path / "link.bin").symlink_to(tmp_path / "w.bin")
    if location == "/w.bin":
        location = str(tmp_path / "w.bin")
    nodes, weights = PLACES[place](elsewhere(location))
    path = saved(tmp_path / "net.onnx", [*nodes, NODE("Add", ["images", "w"], ["output"])], weights)
    for said in refusals(path):
        assert "keeps weights in another file" in said


def test_the_same_net_in_one_file_is_opened(tmp_path):
    for place in PLACES.values():
        nodes, weights = place(number("w", [0.0]))
        path = saved(tmp_path / "net.onnx", [*nodes, NODE("Add", ["images", "w"], ["output"])], weights)
        assert nets.open_net(path)(np.zeros((1, 3, 64, 64), np.float32))[0].shape == (1, 3, 64, 64)


def test_names_that_are_not_utf8(tmp_path):
    yolo = constant_yolo(tmp_path / "yolo.onnx", rows(CELLS, 6))
    odd = os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe.onnx")
    yolo.rename(odd)
    assert detector(odd)(PICTURE).status == "none"


def test_nothing_is_reported_or_kept_in_the_users_folders(tmp_path):
    code = "from simgrab.instrument.read import Reader; Reader()"
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    kept = {key: value for key, value in os.environ.items() if key != "ORT_DISABLE_TELEMETRY"}
    subprocess.run([sys.executable, "-c", code], check=True, env=kept | home)
    assert not list(tmp_path.rglob("*"))


# What is no net --------------------------------------------------------------------------------------------------


def test_what_is_no_onnx_file_is_refused(tmp_path):
    whole = READER_WEIGHTS.read_bytes()
    noise = np.random.default_rng(0).bytes(2**20)
    contents = {
        "empty": b"", "no graph": b"\x3a\x00", "zip": b"PK\x03\x04" + b"\0" * 500, "noise": noise,
        "ORT's own": b"\x18\0\0\0ORTM" + b"\0" * 500, "truncated": whole[: len(whole) // 2],
        "endless number": b"\x3a" + b"\xff" * 50, "longer than the file": b"\x3a\xff\xff\xff\xff\x7f",
        "group": b"\x3b\x3c", "field 0": b"\x02\x00",
    }  # fmt: skip
    for name, content in contents.items():
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(content)
        assert "not an ONNX model" in refusals(path)[0], name


def test_files_beyond_the_limits_are_refused(tmp_path, monkeypatch):
    with (tmp_path / "large.onnx").open("wb") as file:
        file.truncate(nets.MOST_BYTES + 1)  # takes no room on the disk
    assert "the limit is 1024 MiB" in refusals(tmp_path / "large.onnx")[0]
    monkeypatch.setattr(onnx_parts, "MOST_PARTS", 1000)
    (tmp_path / "parts.onnx").write_bytes(b"\x0a\x00" * 1001)
    assert "more than 1000 parts" in refusals(tmp_path / "parts.onnx")[0]
    os.mkfifo(tmp_path / "pipe.onnx")
    for path, reason in {
        tmp_path / "pipe.onnx": "it is a pipe, not a file",
        "/dev/zero": "it is a device, not a file",
        tmp_path / "none.onnx": "No such file",
        tmp_path / ("a" * 300): "File name too long",
    }.items():
        assert reason in refusals(path)[0]


def nested(depth):
    """Graphs in attributes of nodes in graphs, as bytes."""
    body = b""
    for field in (6, 5, 1) * depth + (7,):
        size, length = len(body), b""
        while size > 127:
            size, length = size >> 7, length + bytes([size & 127 | 128])
        body = bytes([field << 3 | 2]) + length + bytes([size]) + body
    return body


@pytest.mark.parametrize(
    "net",
    [
        {"nodes": [NODE("Unheard", ["images"], ["output"])]},
        {"nodes": [NODE("Op", ["images"], ["output"], domain="mine")], "domain": "mine"},
        {"nodes": [NODE("EPContext", ["images"], ["output"], domain="com.microsoft", ep_cache_context="/etc/passwd",
                        embed_mode=0)], "domain": "com.microsoft"},
        {"nodes": [NODE("SequenceConstruct", ["images"], ["output"])],
         "output": helper.make_tensor_sequence_value_info("output", TensorProto.FLOAT, None)},
        {"nodes": [NODE("Cast", ["images"], ["output"], to=TensorProto.STRING)],
         "output": info("output", None, TensorProto.STRING)},
        {"nodes": [NODE("ReduceMean", ["images"], ["output"], keepdims=0)]},
        {"nodes": [NODE("Identity", ["images"], ["output"])], "taken": None},
        {"nodes": [NODE("Identity", ["images"], ["output"])], "taken": ["a", "b", "c", "d"]},
        {"nodes": [NODE("Identity", ["images"], ["output"])], "taken": [1, 3, 0, 0]},
        {"nodes": [NODE("Identity", ["images"], ["output"])], "metadata": {nets.KEY: "[" * 90_000}},
        {"nodes": [NODE("Identity", ["images"], ["output"])], "metadata": {nets.KEY: "[" * 10**6}},
    ],
    ids=["operator", "domain", "context", "sequence", "text", "scalar", "no shape", "free", "empty", "deep", "long"],
)  # fmt: skip
def test_nets_of_another_kind_are_refused(tmp_path, net, capfd):
    refusals(saved(tmp_path / "net.onnx", **net))
    (tmp_path / "deep.onnx").write_bytes(nested(500))
    refusals(tmp_path / "deep.onnx")
    assert capfd.readouterr() == ("", "")


def test_metadata_that_are_made_to_harm(tmp_path):
    free = (1, 3, "h", "w")
    sizes = ["[65536, 65536]", "[-640, -640]", "[0, 0]", f"[{'9' * 4000}, 32]"]
    for imgsz in sizes:
        with pytest.raises(DetectorError, match="multiples of 32, 4096 at most") as refused:
            Yolo(constant_yolo(tmp_path / "n.onnx", rows(CELLS, 6), shape=free, metadata={"imgsz": imgsz}))
        assert len(str(refused.value)) < 500
    for imgsz in ("[" * 5000, "-" * 90_000 + "1", "{[]: 1}", "'\\d'", "9" * 10**6, "[6.5, 1]", "__import__('os')"):
        with pytest.raises(DetectorError, match="is not a detector"):  # 640 then, of which it outputs too few cells
            Yolo(constant_yolo(tmp_path / "n.onnx", rows(CELLS, 6), shape=free, metadata={"imgsz": imgsz}))
    names = "{0: '\\x1b[31mred\\nline', 1: '" + "x" * 9000 + "', 2: [3]}"
    with pytest.raises(DetectorError, match=r"outputs 3 classes \(\\x1b\[31mred\\nline, x{40}, \[3\]\)"):
        Yolo(constant_yolo(tmp_path / "n.onnx", rows(CELLS, 8), metadata={"names": names}))


# Limits of what a net takes --------------------------------------------------------------------------------------


def growing(path, count):
    """A net that makes so many numbers of a picture that is not black."""
    nodes = [
        NODE("ReduceMax", ["images"], ["most"], keepdims=0),
        NODE("Ceil", ["most"], ["one"]),
        NODE("Cast", ["one"], ["whole"], to=TensorProto.INT64),
        NODE("Mul", ["whole", "count"], ["size"]),
        NODE("ConstantOfShape", ["size"], ["zeros"]),
        NODE("Add", ["zeros", "one"], ["output"]),
    ]
    return saved(path, nodes, [number("count", [count], np.int64)])


def test_outputs_are_limited(tmp_path):
    one = np.ones((1, 3, 64, 64), np.float32)
    with pytest.raises(DetectorError, match="output has more than 67108864 numbers"):
        nets.open_net(growing(tmp_path / "n.onnx", nets.MOST_NUMBERS + 1))(one)
    stated = info("output", [1, 10**6, 1000])
    nodes = [NODE("ReduceMean", ["images"], ["m"], keepdims=0), NODE("Expand", ["m", "s"], ["output"])]
    wide = number("s", [1, 10**6, 1000], np.int64)
    for said in refusals(saved(tmp_path / "n.onnx", nodes, [wide], output=stated)):
        assert "has more than 67108864 numbers" in said


def test_memory_is_limited(tmp_path, capfd):
    one = np.ones((1, 3, 64, 64), np.float32)
    for count in (nets.MOST_MEMORY // 4 + 1, 10**12, 2**62):
        net = nets.open_net(growing(tmp_path / "n.onnx", count))
        with pytest.raises(DetectorError, match="does not run") as refused:
            net(one)
        if count < 10**12:
            assert "more memory than there is, or than 4 GiB" in str(refused.value)
    assert capfd.readouterr() == ("", "")


def test_a_loop_that_never_ends_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(nets, "MOST_SECONDS", 0.1)
    body = helper.make_graph(
        [NODE("Identity", ["go"], ["go2"]), NODE("Identity", ["v"], ["v2"])],
        "body",
        [info("i", [], TensorProto.INT64), info("go", [], TensorProto.BOOL), info("v", None)],
        [info("go2", [], TensorProto.BOOL), info("v2", None)],
    )
    path = saved(
        tmp_path / "n.onnx", [NODE("Loop", ["", "go0", "images"], ["output"], body=body)], [number("go0", True, bool)]
    )
    with pytest.raises(DetectorError, match="it takes longer than 0 s"):
        nets.open_net(path)(np.zeros((1, 3, 64, 64), np.float32))


def test_what_ends_in_time_is_not_stopped():
    stopped = []
    for _ in range(3):
        with within(1e9, lambda: stopped.append(1)):
            pass
    assert not stopped


# What a net outputs ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "told",
    [
        [np.nan] * 6, [np.inf] * 6, [32, 24, 20, 10, np.inf, 0], [32, 24, 20, 10, 1, np.nan],
        [32, 24, 20, 10, 37, 1], [32, 24, -20, -10, 1, 1], [1e38, -1e38, 3e38, 3e38, 1, 1], [32, 24, 0, 0, 1, 1],
    ],
)  # fmt: skip
@pytest.mark.parametrize("raw", [False, True])
def test_boxes_that_are_none(tmp_path, told, raw):
    # A net is opened with a grey picture, for which this one outputs nothing odd.
    base, more = rows(CELLS, 6), np.zeros((1, CELLS, 6), np.float32)
    if raw:
        base[...] = 0
    more[0, 9] = told
    nodes = [
        NODE("ReduceMax", ["images"], ["most"], keepdims=0),
        NODE("Greater", ["most", "limit"], ["bright"]),
        NODE("Where", ["bright", "more", "base"], ["output"]),
    ]
    weights = [number("limit", 100.0), number("more", base + more), number("base", base)]
    looks = Yolo(saved(tmp_path / "n.onnx", nodes, weights))
    assert (looks.layout.family, looks.layout.raw) == ("yolox", raw)
    found = looks(np.full((64, 64, 3), 255, np.uint8))
    if not np.isfinite(told).all() or told[4] > 1:
        assert found.status == "none"
    elif found.found:
        x0, y0, x1, y1 = found.box
        assert 0 <= x0 < x1 <= 64
        assert 0 <= y0 < y1 <= 64
    assert 0 <= found.score <= 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e4, -1e4])
@pytest.mark.parametrize("which", ["coarse", "pose"])
def test_nets_of_a_folder_that_output_nan_or_infinity(tmp_path, which, value):
    folder = hand_made(tmp_path / "nets")
    looks = detector(folder)
    path = folder / f"{which}.onnx"
    model = onnx.load(path)
    names = {"coarse": ["twenty"], "pose": ["rows"]}[which]
    for weight in model.graph.initializer:
        if weight.name in names:
            values = np.full_like(numpy_helper.to_array(weight), value)
            weight.CopyFrom(numpy_helper.from_array(values, weight.name))
    onnx.save(model, path)
    if not np.isfinite(value):
        with pytest.raises(DetectorError, match=f"{which}.onnx outputs NaN or infinity"):
            detector(folder)
    # And where a net that is open outputs them for some picture alone.
    field = f"_{which}"
    setattr(looks, field, nets.open_net(path))
    picture = np.zeros((360, 640, 3), np.uint8)
    picture[160:200, 300:340] = 255
    found = looks(picture)
    if found.found:
        assert np.isfinite([*found.box, *found.centre, found.yaw or 0.0, *found.box_sd_px, *found.centre_sd_px]).all()
        assert (found.box >= 0).all()
    assert 0 <= found.score <= 1


def test_folders_that_are_no_detector(tmp_path):
    sound = hand_made(tmp_path / "sound")
    for name, other in (("coarse", "pose"), ("pose", "coarse")):
        for content in (None, b"", b"noise", (sound / f"{other}.onnx").read_bytes(), READER_WEIGHTS.read_bytes()):
            folder = tmp_path / "broken"
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(sound, folder)
            (folder / f"{name}.onnx").unlink()
            if content is not None:
                (folder / f"{name}.onnx").write_bytes(content)
            with pytest.raises(DetectorError, match=f"{name}.onnx") as refused:
                detector(folder)
            assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("part", "wrong"),
    [
        ("settings", {"least_heat": np.nan}), ("settings", {"least_presence": -1}), ("settings", {"room": 1e9}),
        ("settings", {"room": 0}), ("settings", {"rivals": "all"}), ("settings", {"least_heat": True}),
        ("settings", {"least_heat": [0.1]}), ("settings", [1]), ("settings", "abc"), ("settings", None),
        ("calibration", {"centre": np.inf}), ("calibration", {"box": -1}), ("calibration", {"offset": 10**400}),
        ("calibration", {"moon": 1}), ("calibration", 3),
    ],
)  # fmt: skip
def test_settings_that_are_made_to_harm(tmp_path, part, wrong):
    facts = {"task": "grab-pose", "settings": {}, "calibration": {}} | {part: wrong}
    folder = hand_made(tmp_path / "nets")
    with_metadata(folder / "pose.onnx", **{nets.KEY: json.dumps(facts)})
    line = rf"pose\.onnx: ({part}: (.*, got .|moon: unknown key)|its metadata .* {part}\.offset: .*64 bits at most)"
    with pytest.raises(DetectorError, match=line):
        detector(folder)


def test_nets_of_other_shapes_are_refused(tmp_path):
    folder = hand_made(tmp_path / "nets")
    model = onnx.load(folder / "pose.onnx")
    for weight in model.graph.initializer:
        if weight.name in ("rows", "light"):
            weight.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(weight)[:, :3], weight.name))
    model.graph.output[0].type.tensor_type.ClearField("shape")
    onnx.save(model, folder / "pose.onnx")
    with pytest.raises(DetectorError, match=r"has unexpected output shapes \(1 x 3\)"):
        detector(folder)


# The reader ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threshold", ["NaN", "Infinity", "-1", "0", "2", "1e999", "[]", "null", "[" * 50_000])
def test_thresholds_that_are_made_to_harm(tmp_path, threshold):
    path = with_metadata(READER_WEIGHTS, tmp_path / "reader.onnx", **{METADATA: f'{{"threshold": {threshold}}}'})
    with pytest.raises(ReaderError, match=r"threshold must be|was not written by simgrab"):
        Reader(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 3.0])
def test_probabilities_that_are_none_are_not_read(tmp_path, value):
    layout = layouts.load("two-by-four")
    sure = np.zeros((8, 11), np.float32)
    sure[:, 4] = 1
    assert reading(sure, layout, 0.9).status == "read"
    sure[2, 4] = value
    assert reading(sure, layout, 0.9).status == "refused"
    model = onnx.load(READER_WEIGHTS)
    model.graph.node.append(NODE("Mul", [model.graph.output[0].name, "by"], ["scaled"]))
    model.graph.initializer.append(number("by", value))
    model.graph.output[0].name = "scaled"
    onnx.save(model, tmp_path / "reader.onnx")
    with pytest.raises(ReaderError, match="do not add up to 1"):
        Reader(tmp_path / "reader.onnx")
