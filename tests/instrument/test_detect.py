import dataclasses
import json

import cv2
import numpy as np
import pytest
from nets import CELLS, SIDE, constant_yolo, hand_made, info, rows, save, with_metadata

from simgrab.errors import DetectorError
from simgrab.instrument.detect import WEIGHTS, GrabDetector, Yolo, detector
from simgrab.instrument.detect.boxes import covered, iou
from simgrab.instrument.detect.grab import POSE, Settings, peaks, read
from simgrab.instrument.detect.patches import GREY, Patch, around, cut, cut_crop, whole
from simgrab.instrument.net import KEY, open_net

onnx = pytest.importorskip("onnx")
from onnx import TensorProto, helper  # noqa: E402

# Patches ---------------------------------------------------------------------------------------------------------


def test_patches_map_both_ways_exactly():
    patch = Patch(-7, 3, 113, 123)
    points = np.array([[0.25, 17.5], [-7, 3], [113, 123]])
    np.testing.assert_allclose(patch.to_picture(patch.to_shares(points)), points, atol=1e-12)
    np.testing.assert_array_equal(patch.to_shares(points)[1:], [[0, 0], [1, 1]])


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 1024), (640, 480), (1080, 1920), (1919, 1081)])
def test_the_whole_picture_lies_in_its_patch(size):
    patch = whole(*size)
    assert patch.x0 <= 0 <= size[0] <= patch.x1
    assert patch.y0 <= 0 <= size[1] <= patch.y1
    assert (patch.x1 - patch.x0) / (patch.y1 - patch.y0) == pytest.approx(12 / 7, abs=2e-3)
    assert not whole(*size, centred=False).corner.any()


@pytest.mark.parametrize("patch", [Patch(40, 30, 200, 190), Patch(-40, -30, 120, 130), Patch(100, 60, 500, 460)])
def test_what_is_cut_lies_where_the_patch_says(patch):
    picture = np.zeros((240, 320, 3), np.uint8)
    picture[60:100, 60:90] = 255
    crop = cut_crop(picture, patch, 80)
    light = crop[..., 0].astype(float) * (crop[..., 3] == 255)
    if patch.x0 < 90:
        middles = (np.arange(80) + 0.5) / 80
        shares = [(light.sum(axis) * middles).sum() / light.sum() for axis in (0, 1)]
        np.testing.assert_allclose(patch.to_picture(shares), [75, 80], atol=0.05)
    else:
        assert not light.any()
    outside = crop[..., 3] == 0
    assert np.all(crop[outside][:, :3] == GREY)
    edges = patch.to_shares([[0, 0], [320, 240]]).clip(0, 1)
    assert crop[..., 3].mean() / 255 == pytest.approx(np.prod(edges[1] - edges[0]), abs=0.005)
    rows, columns = np.indices((80, 80)) + 0.5
    at = (patch.to_picture(np.stack([columns, rows], axis=-1) / 80) - (160, 120)) / 320  # widths from the middle
    np.testing.assert_allclose((crop[..., 4:].astype(float) - 128) / 127, at.clip(-128 / 127, 1), atol=0.51 / 127)


def test_a_patch_beyond_the_picture_is_grey():
    assert np.all(cut(np.zeros((50, 50, 3), np.uint8), Patch(200, 200, 260, 260), 16, 16) == GREY)


def test_around_is_square_and_centred():
    patch = around([100, 50, 200, 90], 1.5)
    assert patch.size.tolist() == [150, 150]
    np.testing.assert_allclose(patch.to_picture([0.5, 0.5]), [150, 70], atol=0.5)


def test_what_the_smaller_box_shares_is_covered():
    boxes = [[0, 0, 2, 2], [0, 0, 4, 4], [0, 0, 1, 1], [0, 0, 2, 0]]
    others = [[1, 0, 3, 2], [1, 1, 2, 3], [2, 2, 3, 3], [0, 0, 2, 2]]
    np.testing.assert_allclose(covered(boxes, others), [0.5, 1, 0, 0])
    np.testing.assert_array_equal(covered(boxes, others), covered(others, boxes))


def test_iou():
    np.testing.assert_allclose(
        iou([[0, 0, 2, 2], [0, 0, 2, 2], [0, 0, 1, 1]], [[0, 0, 2, 2], [1, 0, 3, 2], [2, 2, 3, 3]]), [1, 1 / 3, 0]
    )


# GrabDetector ----------------------------------------------------------------------------------------------------


def test_peaks_lie_apart_and_come_hottest_first():
    logits = np.full((28, 48), -5.0, np.float32)
    logits[10, 20], logits[10, 21], logits[25, 5] = 2.0, 1.0, 3.0
    reach = np.broadcast_to(np.array([10, 20, 30, 40], np.float32)[:, None, None], (4, 28, 48))
    found = peaks(logits, reach, most=2)
    assert [logit for _, logit in found] == [3.0, 2.0]
    np.testing.assert_allclose(found[1][0], [20.5 * 8 - 10, 10.5 * 8 - 20, 20.5 * 8 + 30, 10.5 * 8 + 40])


def test_reading_the_pose_is_exact():
    out = np.zeros(16)
    out[:6] = [0.25, 0.25, 0.75, 0.5, 0.5, 0.4]
    out[6:12] = np.log(0.01)
    out[12:14] = np.cos(2.4), np.sin(2.4)
    pose = read(out, Patch(100, 200, 300, 400))
    np.testing.assert_allclose(pose.places, [150, 250, 250, 300, 200, 280], atol=1e-4)
    np.testing.assert_allclose(pose.sd, np.sqrt(2) * 2, rtol=1e-5)
    assert pose.yaw == pytest.approx(1.2)
    assert pose.presence == 0


def bright(size=(1080, 1920), at=(700, 400), half=24):  # fills the cell of the coarse map in whose middle it lies
    picture = np.zeros((*size, 3), np.uint8)
    picture[at[1] - half : at[1] + half, at[0] - half : at[0] + half] = 255
    return picture


def test_the_detector_combines_its_nets(tmp_path):
    calibration = {"slope": 0.5, "heat": 0.25, "offset": 1.0, "box": 3.0, "centre": 2.0, "yaw": 1.5}
    found, logits = detector(hand_made(tmp_path, yaw=np.pi / 2, calibration=calibration)).examine(bright())
    assert found.found
    np.testing.assert_allclose(logits, [3.0, 4.0], atol=1e-5)
    # The coarse net gives 20 of 384 px each way, 100 px, and the pose net 0.3 of its crop: of the closer one twice.
    first = Settings().room * 200
    half = 0.3 * first
    side = around([700 - half, 400 - half, 700 + half, 400 + half], Settings().close).size[0]
    mean_side = (first + 2 * side) / 3
    np.testing.assert_allclose(
        found.box, np.array([700, 400] * 2) + 0.3 * mean_side * np.array([-1, -1, 1, 1]), atol=0.01
    )
    np.testing.assert_allclose(found.centre, [700, 400], atol=0.01)
    assert found.yaw == pytest.approx(np.pi / 2)
    assert found.score == pytest.approx(1 / (1 + np.exp(-3.5)))
    sd, apart = np.sqrt(2) * np.exp(-4) * mean_side, 0.3 * (first - side)
    np.testing.assert_allclose(found.box_sd_px, 3 * (sd + apart / 2), rtol=1e-3)
    np.testing.assert_allclose(found.centre_sd_px, 2 * sd, rtol=1e-3)
    assert found.yaw_sd == pytest.approx(1.5 * np.sqrt(2) * np.exp(-3) / 2)
    assert GrabDetector(tmp_path).settings == Settings(least_heat=0.2)


def test_crops_that_contradict_each_other_are_unsure(tmp_path):
    """This net gives every crop the same yaw, so that of the mirror image is a quarter turn off."""
    assert detector(hand_made(tmp_path, yaw=np.pi / 4))(bright()).yaw is None


def test_the_mirror_image_of_a_crop_gives_the_same_pose():
    """By what is shown, and by where in the picture it is shown."""
    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(0, 255, (30, 40, 3), np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)
    made, box = GrabDetector(WEIGHTS), np.array([100.0, 80.0, 160.0, 180.0])
    one = made.pose(picture, box, 1.4, mirrored=True)
    other = made.pose(
        np.ascontiguousarray(picture[:, ::-1]), [640, 0, 640, 0] + box[[2, 1, 0, 3]] * [-1, 1, -1, 1], 1.4
    )
    there = [640, 0, 640, 0, 640, 0] + other.places[[2, 1, 0, 3, 4, 5]] * [-1, 1, -1, 1, -1, 1]
    np.testing.assert_allclose(one.places, there, atol=0.01)
    np.testing.assert_allclose(one.sd, other.sd[[2, 1, 0, 3, 4, 5]], rtol=1e-3)
    np.testing.assert_allclose(np.tan(one.yaw), -np.tan(other.yaw), atol=1e-3)
    assert one.presence == pytest.approx(other.presence, abs=1e-3)


@pytest.mark.parametrize(("presence", "tried"), [(3.0, 1), (-3.0, 2)])
def test_the_search_ends_at_a_candidate_that_is_clearly_the_grab(presence, tried, tmp_path, monkeypatch):
    """The hottest one is smaller than another, whose presence is higher."""
    made, seen = GrabDetector(hand_made(tmp_path, presence=presence, glow=100.0)), []
    run = made.pose
    monkeypatch.setattr(made, "pose", lambda *args, **how: seen.append(args) or run(*args, **how))
    large = bright(at=(1220, 760), half=40) // 255 * 250
    found = made(np.maximum(bright(), large))
    assert len(seen) == tried + 1
    np.testing.assert_allclose(found.centre, [700, 400] if tried == 1 else [1220, 760], atol=20)


@pytest.mark.parametrize(("factor", "stated"), [(22.0, True), (23.0, False)])
def test_a_yaw_whose_interval_holds_every_direction_is_not_stated(factor, stated, tmp_path):
    sd = factor * np.sqrt(2) * np.exp(-3) / 2
    assert (1.96 * sd < np.pi / 2) == stated
    found = detector(hand_made(tmp_path, yaw=np.pi / 2, calibration={"yaw": factor}))(bright())
    assert found.found
    assert (found.yaw is not None, found.yaw_sd is not None) == (stated, stated)


def test_the_most_present_of_the_hottest_places_counts(tmp_path):
    looks = detector(hand_made(tmp_path, presence=-1.0, glow=24.0))
    spots = bright(at=(300, 400))
    assert not looks(spots).found
    spots = np.maximum(spots, bright(at=(1100, 600), half=65) // 255 * 200)
    assert looks.candidates(spots)[0].heat > 0.9 > looks.candidates(spots)[1].heat
    np.testing.assert_allclose(looks(spots).centre, [1100, 600], atol=65)
    for u in (500, 700):  # hotter, and so many that the last is none of the three
        spots = np.maximum(spots, bright(at=(u, 400)))
    assert len(looks.candidates(spots)) == looks.settings.candidates
    assert not looks(spots).found


def test_either_net_can_doubt_a_grab(tmp_path, monkeypatch):
    looks, pose = detector(hand_made(tmp_path, calibration={"heat": 1.0})), GrabDetector.pose
    assert looks(bright()).found

    def doubting(self, picture, box, at, **how):
        found = pose(self, picture, box, at, **how)
        return dataclasses.replace(found, presence=found.presence - 20.0 * (at == looks.settings.close))

    with monkeypatch.context() as patched:
        patched.setattr(GrabDetector, "pose", doubting)
        assert not looks(bright()).found
    assert not detector(hand_made(tmp_path / "cold", heat=-1.3, presence=1.0, calibration={"heat": 1.0}))(
        bright()
    ).found


def test_a_place_much_less_hot_than_the_hottest_is_no_candidate(tmp_path):
    spots = np.maximum(bright(), bright(at=(1100, 600)) // 255 * 160)  # of heats 0.98 and 0.38
    folder = hand_made(tmp_path)
    for rivals, count in ((0.1, 2), (0.5, 1)):
        assert len(GrabDetector(folder, Settings(least_heat=0.2, rivals=rivals)).candidates(spots)) == count


def test_no_grab_comes_with_its_reason(tmp_path):
    dark = np.zeros((1080, 1920, 3), np.uint8)
    none = detector(hand_made(tmp_path))(dark)
    assert (none.status, none.reason, none.box, none.centre) == ("none", "nothing found", None, None)
    none = detector(hand_made(tmp_path / "b", presence=-3.0))(bright())
    assert none.status == "none"
    assert "it looks like something else" in none.reason


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((1080, 1920), np.uint8), np.zeros((1080, 1920, 4), np.uint8), np.zeros((1080, 1920, 3)),
        np.zeros((8, 8, 3), np.uint8), np.zeros((0, 0, 3), np.uint8), None,
    ],
    ids=["grey", "alpha", "float", "tiny", "empty", "none"],
)  # fmt: skip
def test_what_is_no_picture_is_refused(tmp_path, picture):
    with pytest.raises(DetectorError, match=r"uint8 of shape \(height, width, 3\)|too small"):
        detector(hand_made(tmp_path))(picture)


@pytest.mark.parametrize("size", [(1080, 1920), (1920, 1080), (480, 640), (64, 64)])
def test_any_size_of_picture_will_do(tmp_path, size):
    h, w = size
    found = detector(hand_made(tmp_path))(bright(size, (w // 2, h // 2), max(size) // 16))
    assert found.found
    assert 0 <= found.box[0] < found.box[2] <= w
    assert 0 <= found.box[1] < found.box[3] <= h


# Others' ---------------------------------------------------------------------------------------------------------


YOLOS = {  # shape of the output, where what is in it, size of the picture, and the box that this gives
    # A picture twice as wide as high has a quarter of the square above and below it, or YOLOX's half below.
    ("yolov5", False): ((3 * CELLS, 7), 100, [32, 24, 20, 10, 0.9, 0.1, 0.8], (128, 128), [44, 38, 84, 58]),
    ("yolov8", False): ((CELLS, 5), 9, [32, 24, 20, 10, 0.72], (64, 128), [44, 6, 84, 26]),
    ("yolox", False): ((CELLS, 6), 9, [32, 24, 20, 10, 0.9, 0.8], (32, 64), [22, 19, 42, 29]),
    # Stride 16, row 1, column 2.
    ("yolox", True): ((CELLS, 6), 70, [0.5, 0.25, np.log(2), np.log(0.5), 0.9, 0.8], (64, 64), [24, 16, 56, 24]),
}


@pytest.mark.parametrize(("family", "raw"), YOLOS)
def test_layouts_of_yolos(tmp_path, family, raw):
    shape, place, said, size, box = YOLOS[family, raw]
    out = np.zeros((1, *shape), np.float32) if raw else rows(*shape)
    out[0, place] = said
    out = out.transpose(0, 2, 1) if family == "yolov8" else out
    names = {"names": "['truck', 'grab']"} if shape[1] > 6 else None
    looks = detector(constant_yolo(tmp_path / "a.onnx", out, metadata=names))
    assert (looks.layout.family, looks.layout.raw) == (family, raw)
    found = looks(np.zeros((*size, 3), np.uint8))
    np.testing.assert_allclose(found.box, box, rtol=1e-6)
    assert found.score == pytest.approx(0.72)
    assert found.centre is None


def test_of_several_classes_the_grab_alone_counts(tmp_path):
    out = rows(CELLS, 6)
    out[0, 9] = [32, 24, 20, 10, 0.9, 0.3]
    out[0, 30] = [12, 24, 20, 10, 0.1, 0.8]
    picture, turned = np.zeros((64, 64, 3), np.uint8), out.transpose(0, 2, 1)
    for names, score in {"{0: 'truck', 1: 'grab'}": 0.8, "{0: 'grab', 1: 'truck'}": 0.9}.items():
        looks = Yolo(constant_yolo(tmp_path / "two.onnx", turned, metadata={"names": names}))
        assert looks(picture).score == pytest.approx(score)
    for names, problem in {
        "{0: 'truck', 1: 'crane'}": r"outputs 2 classes \(truck, crane\), one of which must be named 'grab'",
        "no literal": "no names",
        "{0: 'grab'}": "names 1 classes and outputs 2",
    }.items():
        with pytest.raises(DetectorError, match=problem):
            Yolo(constant_yolo(tmp_path / "bad.onnx", turned, metadata={"names": names}))


FAMILIES = {"yolov5": (3 * CELLS, False), "yolov6": (CELLS, False), "yolox": (CELLS, False), "yolov8": (CELLS, True)}


@pytest.mark.parametrize("family", FAMILIES)
def test_pictures_go_in_as_the_trainers_feed_them(family, tmp_path, monkeypatch):
    count, turned = FAMILIES[family]
    out = rows(count, 5 if turned else 6)
    out[0, :, 4] = 1 if family == "yolov6" else 0.5
    out = out.transpose(0, 2, 1) if turned else out
    looks = Yolo(constant_yolo(tmp_path / "any.onnx", out))
    assert looks.layout.family == family
    fed = []
    monkeypatch.setattr(type(looks._net), "__call__", lambda _, pictures, *_names: fed.append(pictures) or [out])
    picture = np.full((64, 128, 3), (200, 100, 50), np.uint8)  # RGB, twice as wide as high
    looks(picture)
    ((pixels,),) = fed
    assert pixels.shape == (3, SIDE, SIDE)
    assert pixels.dtype == np.float32
    if family == "yolox":
        inside, around, colour, white = pixels[:, :32], pixels[:, 33:], (50, 100, 200), 1
    else:
        inside, around = pixels[:, 17:47], pixels[:, [*range(15), *range(49, 64)]]
        colour, white = (200, 100, 50), 255
    colours = np.broadcast_to(np.reshape(colour, (3, 1, 1)), inside.shape)
    np.testing.assert_allclose(inside * white, colours, rtol=1e-6)
    np.testing.assert_allclose(around * white, GREY, rtol=1e-6)


def test_a_free_size_is_the_one_it_was_trained_at(tmp_path):
    free = (1, 3, "height", "width")
    out = rows(4 * CELLS, 5).transpose(0, 2, 1)
    looks = Yolo(constant_yolo(tmp_path / "free.onnx", out, shape=free, metadata={"imgsz": "[128, 128]"}))
    assert (looks.height, looks.width) == (128, 128)
    with pytest.raises(DetectorError, match="is not a detector"):  # 640 then, of which it outputs too few cells
        Yolo(constant_yolo(tmp_path / "none.onnx", out, shape=free))
    with pytest.raises(DetectorError, match=r"640 x 640 of tensor\(float16\)"):
        Yolo(half_precision(tmp_path / "half.onnx"))


def half_precision(path):
    cast, shape = helper.make_node("Cast", ["images"], ["output"], to=TensorProto.FLOAT), [1, 3, 640, 640]
    return save(path, [cast], [info("images", shape, TensorProto.FLOAT16)], [info("output", shape)])


def test_outputs_besides_the_boxes_may_be_of_any_type(tmp_path):
    out = rows(CELLS, 5)
    out[0, 9] = [32, 24, 20, 10, 0.8]
    path = constant_yolo(tmp_path / "v8.onnx", out.transpose(0, 2, 1))
    net = onnx.load(path)
    net.graph.node.append(helper.make_node("Shape", ["images"], ["size"]))
    net.graph.output.append(helper.make_tensor_value_info("size", TensorProto.INT64, [4]))
    onnx.save(net, path)
    assert Yolo(path)(np.zeros((64, 64, 3), np.uint8)).score == pytest.approx(0.8)
    with pytest.raises(DetectorError, match="its output size is not an array of floats"):
        open_net(path)(np.zeros((1, 3, SIDE, SIDE), np.float32))


def test_scores_that_are_rounded_to_more_than_1_count_as_1(tmp_path):
    out = rows(CELLS, 5)
    out[0, 9] = [32, 24, 20, 10, 1.0000002]
    out[0, 30] = [12, 24, 20, 10, 0.9]
    found = Yolo(constant_yolo(tmp_path / "v8.onnx", out.transpose(0, 2, 1)))(np.zeros((64, 64, 3), np.uint8))
    assert found.score == 1
    np.testing.assert_allclose(found.box, [22, 19, 42, 29])


def test_a_yolo_that_sees_nothing(tmp_path):
    none = detector(constant_yolo(tmp_path / "v5.onnx", rows(3 * CELLS, 6)))(np.zeros((64, 64, 3), np.uint8))
    assert none.status == "none"
    assert "0.25" in none.reason
    out = rows(CELLS, 5)
    out[0, 9] = [32, 4, 20, 6, 0.9]  # in the grey above a picture that is twice as wide as high
    beyond = Yolo(constant_yolo(tmp_path / "v8.onnx", out.transpose(0, 2, 1)))(np.zeros((64, 128, 3), np.uint8))
    assert (beyond.status, beyond.reason) == ("none", "its box lies outside the picture")
    out[0, 9] = [32, 24, np.nan, 10, 0.9]
    nan = Yolo(constant_yolo(tmp_path / "nan.onnx", out.transpose(0, 2, 1)))
    assert nan(np.zeros((64, 64, 3), np.uint8)).score == 0


def test_what_is_no_detector_is_refused(tmp_path):
    for name, path in {
        "classifier": constant_yolo(tmp_path / "a.onnx", np.zeros((1, 1000))),
        "rows of no grid": constant_yolo(tmp_path / "b.onnx", np.zeros((1, 77, 6))),
        "maps": constant_yolo(tmp_path / "c.onnx", np.zeros((1, 2, 64, 64))),
        "grey": constant_yolo(tmp_path / "d.onnx", rows(CELLS, 6), shape=(1, 1, SIDE, SIDE)),
    }.items():
        with pytest.raises(
            DetectorError, match="not a detector: a detector takes floats 1 x 3 x height x width"
        ) as told:
            detector(path)
        assert "this has inputs images 1 x" in str(told.value), name
    masks = rows(CELLS, 38)
    masks[0, :, 6:] = 3.2  # coefficients
    with pytest.raises(DetectorError, match="outputs 34 classes"):
        detector(constant_yolo(tmp_path / "m.onnx", masks.transpose(0, 2, 1)))
    logits = rows(CELLS, 5)
    logits[0, :, 4] = 3.2
    with pytest.raises(DetectorError, match="outputs scores of"):
        detector(constant_yolo(tmp_path / "l.onnx", logits.transpose(0, 2, 1)))
    segments = constant_yolo(tmp_path / "s.onnx", rows(CELLS, 6).transpose(0, 2, 1))
    with pytest.raises(DetectorError, match="is not a detector"):
        detector(with_metadata(segments, task="segment"))
    with pytest.raises(DetectorError, match="multiples of 32"):
        detector(constant_yolo(tmp_path / "e.onnx", rows(CELLS, 6), shape=(1, 3, 60, 60)))
    ours = hand_made(tmp_path / "g")
    for facts, problem in {
        "no JSON": "was not written by simgrab",
        "[1]": "was not written by simgrab",
        json.dumps({"task": POSE}): "has no settings in its metadata",
    }.items():
        with_metadata(ours / "pose.onnx", **{KEY: facts})
        with pytest.raises(DetectorError, match=problem):
            detector(ours)


def test_a_detector_is_called_by_its_folder(tmp_path):
    assert detector(hand_made(tmp_path / "mine") / "pose.onnx").name == "mine"


def test_the_bundled_detector_is_called_so():
    assert detector().name == detector(WEIGHTS).name == "bundled"
