import dataclasses
import hashlib
from types import SimpleNamespace

import cv2
import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from scipy.special import expit, logit  # noqa: E402

from simgrab.dataset import datasets  # noqa: E402
from simgrab.dataset.tables import table_of  # noqa: E402
from simgrab.errors import TrainingError  # noqa: E402
from simgrab.instrument.detect.grab import Calibration, Settings  # noqa: E402
from simgrab.instrument.detect.patches import GREY, POSE_SIZE, Patch, cut  # noqa: E402
from simgrab.model import label_arrays as labels  # noqa: E402
from simgrab.model.records.observations import Detection  # noqa: E402
from simgrab.model.rng import stream  # noqa: E402
from simgrab.training import loop  # noqa: E402
from simgrab.training.detector import cache, coarse, evaluate, nets, pose, settings  # noqa: E402
from simgrab.training.detector.augment import Dirt, Orientation, _hues  # noqa: E402
from simgrab.training.detector.trunk import CHANNELS, PACKAGE, Trunk  # noqa: E402

FIRST = tuple(f"blocks.{i}." for i in range(5))


def middle(light):
    """Centroid of a picture in shares of it: the middle of its first pixel lies half a pixel from its corner."""
    x, y = ((np.arange(n) + 0.5) / n for n in light.shape[::-1])
    return np.array([(light.sum(0) * x).sum(), (light.sum(1) * y).sum()]) / light.sum()


def rectangle(box, width, height):
    """A picture of a light rectangle on black, its edges anti-aliased exactly: (height, width, 3)."""
    x = np.diff(np.clip(np.arange(width + 1), box[0], box[2]))
    y = np.diff(np.clip(np.arange(height + 1), box[1], box[3]))
    return np.repeat(np.round(255 * np.outer(y, x)).astype(np.uint8)[..., None], 3, axis=2)


def bounds(lit):
    """Box of the pixels that are set."""
    ys, xs = np.nonzero(lit)
    return [xs.min(), ys.min(), xs.max() + 1, ys.max() + 1]


# Augmentation ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("quarters", range(4))
def test_labels_turn_with_the_picture(mirror, quarters):
    laid = Orientation(mirror, quarters)
    box = np.array([10, 20, 22, 52])
    picture = rectangle(box, 64, 64)
    shares = box / 64
    turned = laid.picture(picture)[..., 0].astype(float)
    np.testing.assert_allclose(middle(turned), laid.points((shares[:2] + shares[2:]) / 2), atol=1e-9)
    np.testing.assert_allclose(laid.box(shares) * 64, bounds(turned), atol=1e-9)
    angle = 0.3
    step = laid.points(np.array([0.5, 0.5]) + 0.1 * np.array([np.cos(angle), np.sin(angle)])) - laid.points(
        np.array([0.5, 0.5])
    )
    np.testing.assert_allclose(step / 0.1, [np.cos(laid.angle(angle)), np.sin(laid.angle(angle))], atol=1e-9)


def test_zooms_take_the_box_along():
    box = np.array([200.0, 90.0, 260.0, 170.0])
    small = rectangle(box, 384, 224)
    checked = 0
    for i in range(40):
        picture, moved = coarse._shifted(small, box, stream(0, i, "shift"))
        x0, y0, x1, y1 = np.concatenate([moved[:2] - 4, moved[2:] + 4]).astype(int)
        around = picture[max(y0, 0) : y1, max(x0, 0) : x1, 0].astype(float)
        if np.array_equal(moved, box) or around.shape != (y1 - y0, x1 - x0) or around[[0, -1]].any():
            continue  # as it was, or at the edge of the picture
        seen = middle(around) * around.shape[::-1] + (x0, y0)
        np.testing.assert_allclose(seen, (moved[:2] + moved[2:]) / 2, atol=0.1)
        checked += 1
    assert checked > 5


def test_dirt_keeps_the_shape_and_depends_on_its_stream_alone():
    picture = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    dirt = Dirt()
    for i in range(30):
        a, b = (dirt(picture.copy(), stream(0, i, "dirt")) for _ in range(2))
        assert a.shape == picture.shape
        assert a.dtype == np.uint8
        np.testing.assert_array_equal(a, b)


def test_hues_turn_about_grey():
    grey, red = (np.full((1, 1, 3), colour, np.uint8) for colour in (90, (160, 80, 80)))
    hues = _hues(2 * np.pi / 3)
    np.testing.assert_array_equal(cv2.transform(grey, hues), grey)
    np.testing.assert_array_equal(cv2.transform(red, hues)[0, 0], [80, 160, 80])
    assert cv2.transform(red, _hues(1.0)).sum(dtype=int) == pytest.approx(red.sum(dtype=int), abs=2)


# Targets ---------------------------------------------------------------------------------------------------------


def test_coarse_targets_lead_back_to_the_box():
    box = np.array([100.3, 40.7, 180.9, 120.2])
    heat, reach = coarse.target(box)
    row, column = np.argwhere(heat == 1)[0]
    at = (np.array([column, row, column, row]) + 0.5) * nets.STRIDE
    np.testing.assert_allclose(at + reach[:, row, column] * [-1, -1, 1, 1], box, atol=1e-4)
    assert np.abs(at[:2] - (box[:2] + box[2:]) / 2).max() <= nets.STRIDE / 2
    assert (heat == 1).sum() == 1
    assert not coarse.target(np.full(4, np.nan))[0].any()


def test_the_coarse_loss_is_least_at_its_target():
    heat, reach = (torch.from_numpy(x)[None] for x in coarse.target(np.array([100.3, 40.7, 180.9, 120.2])))
    sure = torch.where(heat == 1, 12.0, -12.0)
    assert coarse.focal(sure, heat) < 1e-3 < coarse.focal(-sure, heat)
    assert coarse.box_loss(reach, reach, heat).abs() < 1e-6
    assert coarse.box_loss(reach * 1.1, reach, heat) > 0.05


def frame_of(row, box, path, width=640, height=360):
    """A frame that shows a light rectangle for a grab."""
    u, v = box[0] + 20, box[1] + 10
    cv2.imwrite(str(path), rectangle(box, width, height))
    edges = dict(zip(("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"), map(int, box), strict=True))
    centre = {"grab_u_px": float(u), "grab_v_px": float(v)}
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    row = msgspec.structs.replace(row, width_px=width, height_px=height, image_sha256=digest, **edges, **centre)
    return cache.TrainingFrame(row, path, True, "")


BOX = (200, 100, 300, 160)


@pytest.fixture
def cropped(dataset, tmp_path):
    """Crops of frames with rectangles for grabs, in which the coarse net took boxes for the grab."""
    row = datasets.read(dataset).rows[0]

    def make(*boxes, suspects=()):
        folder = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        frames = [frame_of(row, box, tmp_path / f"{folder.name}-{i}.png") for i, box in enumerate(boxes)]
        return pose.crops(folder, frames, [suspects] * len(frames), seed=0)

    return make


def example_of(crops, trial, i=0):
    """An example with the grab, without dirt."""
    return pose._example(crops, i, False, stream(0, trial, "example"), lambda picture, _: picture)


def test_examples_of_the_pose_net_show_what_they_say(cropped, monkeypatch):
    monkeypatch.setattr(pose, "_CUT_SHARE", 0)
    boxes = [BOX, (0, 50, 90, 150), (560, 300, 640, 360)]
    crops = cropped(*boxes)
    sides, parts = list[float](), 0
    for i, box in enumerate(boxes):
        for trial in range(80):
            example = example_of(crops, trial, i)
            inside = example["crops"][..., 3] == 255
            light = np.where(inside, example["crops"][..., 0], 0) > 127
            places = example["places"] * POSE_SIZE
            seen = bounds(light)
            edges = np.clip(places[:4], 0, POSE_SIZE)
            np.testing.assert_allclose(seen, edges, atol=1.1, err_msg=f"{box} {trial}")
            assert (np.abs(example["places"] - 0.5) < pose.FARTHEST - 0.5).all()
            sides.append(POSE_SIZE / (places[2:4] - places[:2]).max())
            parts += not np.array_equal(edges, places[:4])
            if i == 0 and np.array_equal(edges, places[:4]):
                beside = np.s_[max(seen[1] - 2, 0) : seen[3] + 2, max(seen[0] - 2, 0) : seen[2] + 2]
                lit = np.zeros((POSE_SIZE, POSE_SIZE))  # without the grey beyond the picture, which its edge mixes in
                lit[beside] = (example["crops"][..., 0] * inside)[beside]
                np.testing.assert_allclose(middle(lit) * POSE_SIZE, (places[:2] + places[2:4]) / 2, atol=0.1)
            assert example["known"][:4].all()
        nothing = pose._example(crops, i, True, stream(0, 0, "example"), None)
        assert not nothing["known"].any()
        assert nothing["present"] == 0
    # Most as around a box much like the grab's, or closer, as the detector looks again; some as around a part of it.
    assert 0.4 < np.mean((np.array(sides) > 1.65) & (np.array(sides) < 2.75)) < 0.65
    assert 0.25 < np.mean((np.array(sides) > 1.15) & (np.array(sides) < 1.65)) < 0.45
    assert np.min(sides) < 1.2
    assert parts > 4


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("quarters", range(4))
def test_places_turn_with_the_crop(cropped, monkeypatch, mirror, quarters):
    monkeypatch.setattr(pose, "_CUT_SHARE", 0)
    monkeypatch.setattr(pose, "turn", lambda *_, **__: Orientation(mirror, quarters))
    crops = cropped(BOX)
    for trial in range(8):
        example = example_of(crops, trial)
        if example["places"][:4].min() < 0 or example["places"][:4].max() > 1:
            continue  # a part of the grab
        x, y = (250 - 320) / 640, (130 - 180) / 640  # from the picture's middle to the rectangle's, in widths
        x = -x if mirror else x
        for _ in range(quarters):
            x, y = -y, x
        light = np.where(example["crops"][..., 3] == 255, example["crops"][..., 0], 0) > 200
        seen = (example["crops"][light][:, 4:].astype(float).mean(axis=0) - 128) / 127
        np.testing.assert_allclose(seen, [x, y], atol=0.003)


def test_the_edge_that_a_crop_is_given_cuts_picture_box_and_places(cropped, monkeypatch):
    """The crop is one of a picture of the same size that was taken elsewhere."""
    monkeypatch.setattr(pose, "_CUT_SHARE", 1)
    monkeypatch.setattr(pose, "turn", lambda *_, **__: Orientation(False, 0))
    crops, drawn = cropped(BOX), set()
    for trial in range(60):
        example = example_of(crops, trial)
        colours, inside = example["crops"][..., 0], example["crops"][..., 3]
        assert (colours[inside == 0] == GREY).all()
        x0, y0, x1, y1, u, v = example["places"] * POSE_SIZE
        at_edge = np.abs(np.subtract(bounds(inside == 255), [x0, y0, x1, y1])) < 1.01
        if (inside == 255).all():
            continue  # the crop ends before the picture does
        assert at_edge.any()
        side = int(np.flatnonzero(at_edge)[0])
        drawn.add(side)
        # The centre is no longer in the middle of the box.
        assert abs(((x0 + x1) / 2 - u, (y0 + y1) / 2 - v)[side % 2]) > 0.02 * (x1 - x0, y1 - y0)[side % 2]
        lit = (colours > 200) & (inside == 255)
        np.testing.assert_allclose(bounds(lit), np.clip([x0, y0, x1, y1], 0, POSE_SIZE), atol=1.6)
        # The picture's edge lies half of its width, or height, from its middle.
        along = example["crops"][inside == 255, 4 + side % 2]
        half = 0.5 if side % 2 == 0 else 0.5 * 360 / 640
        last = float(along.min() if side < 2 else along.max())
        assert (last - 128) / 127 == pytest.approx(-half if side < 2 else half, abs=0.02)
    assert drawn == {0, 1, 2, 3}


def test_what_the_coarse_net_suspects_becomes_a_hard_example_unless_it_is_the_grab(cropped):
    grab = [np.array(one, float) for one in (BOX, (0, 0, 500, 330), (240, 120, 260, 140), (120, 60, 220, 160))]
    beside, far = np.array([300.0, 80, 400, 180]), np.array([400.0, 200, 500, 300])
    patches = cropped(*[BOX] * 8, suspects=[*grab, beside, far]).patches
    shown, others = ({tuple(pair[slot].to_picture([0.5, 0.5]).round()) for pair in patches} for slot in (0, 1))
    assert shown == {(250, 130)}
    assert others == {(350, 130), (450, 250)}  # and not of all frames the same
    for _, other in cropped(*[BOX] * 8, suspects=grab).patches:
        half = other.size / pose.ROOM / 2
        middle = other.to_picture([0.5, 0.5])
        assert pose.apart(np.concatenate([middle - half, middle + half]), np.array(BOX, float))
    ((_, other),) = cropped((0, 0, 640, 360)).patches
    np.testing.assert_array_less([640, 360], other.to_picture([0.5, 0.5]))


def posed(*places):
    """Batch of one grab of which all is known."""
    there = {"known": torch.ones(1, 6), "turned": torch.tensor([[0.0, 1.0]]), "present": torch.ones(1)}
    return there | {"places": torch.tensor([places])}


def test_the_pose_loss_is_least_at_its_target():
    batch = posed(0.2, 0.3, 0.7, 0.8, 0.5, 0.4)
    out = torch.full((1, nets.COLUMNS), -8.0)
    out[:, :6], out[:, nets.YAW], out[:, nets.PRESENCE] = batch["places"], batch["turned"], 12.0
    best = pose.loss(out, batch)
    for column, change in ((0, 0.1), (5, 0.1), (12, 5.0), (15, -14.0)):
        worse = out.clone()
        worse[:, column] += change
        assert pose.loss(worse, batch) > best + 0.05, column
    unknown = batch | {"known": torch.zeros(1, 6)}
    moved = out.clone()
    moved[:, 0] += 0.3
    assert pose.loss(moved, unknown) == pose.loss(out, unknown)


@pytest.mark.parametrize("column", [6, 11, nets.YAW_SCALE])
def test_scales_far_too_small_do_not_drown_what_else_is_to_learn(column):
    def gradient(scale):
        out = torch.full((1, nets.COLUMNS), 0.4)
        out[:, column] = scale
        out.requires_grad_(True)
        pose.loss(out, posed(*[0.5] * 6)).backward()
        assert torch.isfinite(out.grad).all()
        return float(out.grad[0, column])

    assert gradient(-200.0) == gradient(-20.0) < gradient(-2.5) < 0  # grows with the surprise, to a bound


def test_weights_are_best_on_the_cells_beside_a_position():
    batch = posed(0.5, 0.51, 0.1, 0.9, -0.1, 1.1)
    places = batch["places"]
    cells = 40 + 2 * nets.BEYOND
    middles = (torch.arange(-nets.BEYOND, 40 + nets.BEYOND) + 0.5) / 40
    near = torch.relu(1 - 40 * (middles - places[0][:, None]).abs())[None]  # what the mean of which is the position
    np.testing.assert_allclose((near * middles).sum(-1), places, atol=1e-5)
    best = pose.spread((near + 1e-9).log(), batch)
    for other in (near.roll(1, -1), near.roll(-1, -1), torch.full((1, 6, cells), 1 / cells)):
        assert pose.spread((other + 1e-9).log(), batch) > best + 0.5


# The soft-argmax -------------------------------------------------------------------------------------------------


def test_positions_lie_in_the_middle_of_cells():
    told = nets._Positions()
    for weight in told.parameters():
        torch.nn.init.zeros_(weight)
    profile = torch.zeros(1, told.enter.in_channels, 40)
    summary = torch.zeros(1, told.context.in_features)
    flat, _ = told(profile, summary)
    np.testing.assert_allclose(flat.detach(), 0.5, atol=1e-6)  # the middle of all cells is the middle of the crop
    with torch.no_grad():
        told.enter.weight[0, 0, 0] = 1.0
        for layer in told.layers[::2]:
            layer.weight[:, 0, 4] = 100.0
    profile[0, 0, 7] = 1.0
    np.testing.assert_allclose(told(profile, summary)[0].detach(), 7.5 / 40, atol=1e-6)


# The nets --------------------------------------------------------------------------------------------------------


def test_the_trunk_is_the_pretrained_network():
    """Mean magnitudes are of the package efficientnet_lite_pytorch 0.1.0."""
    pytest.importorskip(PACKAGE)
    x, y = np.meshgrid(np.arange(128), np.arange(96))
    waves = np.stack([np.sin(x / 9 + y / 17), np.sin(x / 5 - y / 7), np.cos(y / 4)]).astype(np.float32)
    with torch.inference_mode():
        levels = Trunk().load().eval()(torch.from_numpy(waves)[None])
    found = {stride: float(level.abs().mean()) for stride, level in levels.items()}
    assert found == pytest.approx({4: 9.62953, 8: 8.25072, 16: 5.47663, 32: 4.03224}, rel=1e-4)
    assert {stride: level.shape[1] for stride, level in levels.items()} == CHANNELS


def test_statistics_of_norms_first_blocks_and_depthwise_kernels_stay_while_the_rest_learns():
    net = nets.Coarse()
    before = {name: value.clone() for name, value in net.trunk.state_dict().items()}
    optimiser = torch.optim.AdamW(loop.groups(net, 0.02), lr=1e-3)
    net.train()
    heat, reach = net(torch.randint(0, 256, (2, 64, 96, 3), dtype=torch.uint8))
    (heat.square().mean() + reach.mean()).backward()
    optimiser.step()
    changed = {name for name, value in net.trunk.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {
        name for name, weight in net.trunk.named_parameters()
        if not name.startswith(("stem", *FIRST)) and not name.endswith("depthwise.1.weight")
    }  # fmt: skip


# Caches, figures -------------------------------------------------------------------------------------------------


def test_a_cache_is_made_once_and_whole_or_not_at_all(dataset, tmp_path):
    frames = cache.frames([datasets.read(dataset)], "train")
    made = []

    def shrink(i, picture):
        made.append(i)
        if len(made) == stop:
            raise KeyboardInterrupt
        return cut(picture, Patch(0, 0, 480, 270), 16, 8), [Patch(i, 0, 1, 1)]

    stop = 2
    with pytest.raises(KeyboardInterrupt):
        cache.build(tmp_path / "c", frames, (8, 16, 3), shrink)
    assert not list(tmp_path.iterdir())
    stop = 0
    first, patches = cache.build(tmp_path / "c", frames, (8, 16, 3), shrink)
    count = len(made)
    again, same = cache.build(tmp_path / "c", frames, (8, 16, 3), shrink)
    assert len(made) == count
    np.testing.assert_array_equal(first, again)
    assert patches == same == [[Patch(i, 0, 1, 1)] for i in range(len(frames))]
    (tmp_path / "c" / "bytes.npy").unlink()  # killed while it was removed
    np.testing.assert_array_equal(cache.build(tmp_path / "c", frames, (8, 16, 3), shrink)[0], first)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("patches.json", b"[" * 100_000), ("patches.json", b"\xff"), ("patches.json", b'[["a"]]'),
        ("patches.json", b"[[[1e999,0,0,0]]]"), ("patches.json", b"{}"), ("bytes.npy", b""),
        ("bytes.npy", b"noise" * 99), ("bytes.npy", "objects"), ("bytes.npy", "other"), ("bytes.npy", "floats"),
    ],
)  # fmt: skip
def test_a_damaged_cache_is_refused(dataset, tmp_path, name, content):
    frames = cache.frames([datasets.read(dataset)], "train")
    shape = (8, 16, 3)
    cache.build(tmp_path, frames, shape, lambda _i, _picture: (np.zeros(shape, np.uint8), [Patch(0, 0, 1, 1)]))
    arrays = {
        "objects": np.array([print], object),  # pickled
        "other": np.zeros((1, *shape), np.uint8),
        "floats": np.zeros((len(frames), *shape)),
    }
    if isinstance(content, str):
        np.save(tmp_path / name, arrays[content])
    else:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(TrainingError, match="is damaged"):
        cache.build(tmp_path, frames, shape, lambda _i, _picture: pytest.fail("made anew"))


def test_a_cache_that_does_not_fit_is_refused(dataset, tmp_path, monkeypatch):
    frames = cache.frames([datasets.read(dataset)], "train")
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=100))
    with pytest.raises(TrainingError, match=r"needs 0\.0 GB, and only 0\.0 GB are free"):
        cache.build(tmp_path / "c", frames, (8, 16, 3), lambda *_: None)
    assert not list(tmp_path.iterdir())


def test_frames_leave_slivers_out(dataset):
    known = datasets.read(dataset)
    row = known.rows[0]
    sliver = msgspec.structs.replace(row, visible_fraction=0.05)
    empty = msgspec.structs.replace(row, box_x0_px=None, visible_fraction=0.0)
    some = known.with_rows(table_of([row, sliver, empty]))
    assert [frame.labelled for frame in cache.frames([some], row.split)] == [True, False]


LOOKS = SimpleNamespace(settings=Settings())


@pytest.fixture
def detected(dataset):
    """Makes a frame, with a grab or without, in which one is found where it is but for an error."""
    row = datasets.read(dataset).rows[0]

    def make(there=True, score=1.0, logits=(0, 0), off=(0,) * 7):
        off = np.array(off)
        box, centre = labels.box(row) + off[:4], labels.centre(row) + off[4:6]
        yaw = (labels.yaw(row) + off[6]) % np.pi
        found = Detection("found", "", score, box, centre, yaw, np.ones(4), np.ones(2), 0.01)
        return evaluate.DetectedFrame(cache.TrainingFrame(row, row.file, there), found, np.array(logits))

    return make


def test_stated_deviations_are_scaled_to_hold_95_percent(detected):
    errors = np.random.default_rng(0).normal(0, [2.0] * 4 + [0.5] * 2 + [0.03], (2000, 7))
    seen = [detected(off=off) for off in errors]
    found = evaluate.calibrated(LOOKS, seen)[0]["calibration"]
    assert (found["box"], found["centre"], found["yaw"]) == pytest.approx((2.0, 0.5, 3.0), rel=0.08)
    assert evaluate.calibrated(LOOKS, seen[:3])[0]["calibration"]["centre"] == 1.0


def test_presences_become_probabilities(detected):
    rng, true = np.random.default_rng(0), Calibration(slope=0.5, heat=0.25, offset=1.0)
    logits = rng.uniform(-8, 8, (6000, 2))
    there = rng.random(6000) < [true.presence(some) for some in logits]
    seen = [detected(bool(yes), logits=some) for some, yes in zip(logits, there, strict=True)]
    fitted = evaluate.regression(seen)
    assert (fitted.slope, fitted.heat, fitted.offset) == pytest.approx((0.5, 0.25, 1.0), abs=0.08)
    assert evaluate.recalibrated(seen[:1], true)[0].detection.score == pytest.approx(expit(logits[0] @ [0.5, 0.25] + 1))
    assert evaluate.regression(seen[:20]) is None  # too few
    first = SimpleNamespace(settings=Settings(), calibration=Calibration(slope=0.7, heat=0.3, offset=-0.4))
    found = evaluate.calibrated(LOOKS, seen[:20], before=first)[0]["calibration"]
    assert (found["slope"], found["heat"], found["offset"]) == (0.7, 0.3, -0.4)


def test_a_threshold_falls_only_if_enough_frames_show_no_grab(detected):
    grab, empty = detected(score=0.6, logits=(logit(0.6), 0)), detected(there=False)
    empty = dataclasses.replace(empty, detection=Detection("none", "nothing found", 0.0))
    for count, before, kept in ((49, 0.85, True), (50, 0.85, False), (49, 0.0, False), (5, 0.2, False)):
        first = SimpleNamespace(settings=Settings(least_presence=before), calibration=Calibration())
        facts, figures = evaluate.calibrated(LOOKS, [grab] + [empty] * count, before=first)
        presence = facts["settings"]["least_presence"]
        assert presence == before if kept else 0.2 < presence < 0.6
        assert figures["recall"] == (0 if kept else 1)


def test_the_least_presence_lies_where_it_errs_least(detected):
    grabs = [detected(True, p) for p in (0.12, 0.7, 0.95, *[0.96] * 10, 0.99)]
    empty = [detected(False, p) for p in (0.02, 0.2, 0.3, 0.97)]
    assert logit(evaluate.least_presence(grabs + empty)) == pytest.approx(0.1 * logit(0.3) + 0.9 * logit(0.7))
    assert evaluate.least_presence(grabs) < 0.12
    assert evaluate.least_presence(empty) == 0.9
    assert evaluate.least_presence([]) == 0.5
    assert evaluate.least_presence(grabs[:3] + empty) == 0.9  # two more grabs are missed, for one false box less
    kept = evaluate.by(0.5, grabs + empty)
    assert [one.detection.found for one in kept] == [False, *[True] * 13, False, False, False, True]
    assert kept[0].detection.score == 0.12


def test_the_recipe_shows_as_many_frames_however_many_there_are():
    few, many = (settings.recipes(frames, half=False) for frames in (500, 5000))
    for name in settings.SHOWN:
        assert few[name].epochs * 500 == pytest.approx(many[name].epochs * 5000, rel=0.1)
    for started in (False, True):
        quick, usual = (settings.recipes(750, quick=one, started=started, half=False) for one in (True, False))
        for name in settings.SHOWN:
            assert quick[name].epochs * 2 < usual[name].epochs
    assert settings.recipes(8, epochs=3, half=False)["pose"].epochs == 3
