"""Measure the rivals' methods on the same swings, and write the table of their errors.

    python -m scripts.rivals clips --part sensors --clips 4
    python -m scripts.rivals clips --part pictures --clips 2
    python -m scripts.rivals clips --part marks --clips 1
    python -m scripts.rivals clips --part lidar --clips 1
    python -m scripts.rivals clips --part side --clips 2 --condition calm
    python -m scripts.rivals page

The first commands make clips of 30 s at 9 Hz and measure them with every method that takes sensors alone, pictures of
640×360 px too, marks on the grab in pictures of 960×540 px (for 15 s), a LiDAR, or cameras at the side (for 15 s). The
angles are kept in a file a clip and part below ``runs/rivals``. The last command writes ``docs/results/rivals.md`` from
the files that there are.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
import numpy as np

import simgrab
from simgrab.dataset import sensors as sensor_files
from simgrab.dataset.tables import calibration_of, into
from simgrab.instrument.contract import Frame
from simgrab.instrument.detect import detector
from simgrab.instrument.estimate import Estimator, InertialFusion, RopeAware
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.observation import observe
from simgrab.lab.rivals.balls import tysse
from simgrab.lab.rivals.camera import conclude, kawai, matsuo, optical_flow, target_angles
from simgrab.lab.rivals.contract import Sensors, Series
from simgrab.lab.rivals.inertial import INERTIAL
from simgrab.lab.rivals.lidar import Scans, lidar
from simgrab.lab.rivals.marks import FINDERS, Fiducial, Layered, RestMark, level_layers
from simgrab.lab.rivals.ropes import okubanjo
from simgrab.lab.rivals.side import SideView, read_view
from simgrab.lab.rivals.tracking import template
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, rotation_y
from simgrab.model.scenario import Scenario
from simgrab.world.extensions import Recipe
from simgrab.world.sensors.record import Recording

RATE_HZ = 9.0
FRAMES = 270
SIZE = (640, 360)
ROPES_M = (18.0, 14.0, 22.0)
BLOCK_S = 10.0
REPLICATIONS = 2000
MOUNTS = ("jib-head", "rope", "grab", "camera")
PARTS = ("sensors", "pictures", "marks", "lidar", "side")
MARKED_SIZE, MARKED_FRAMES = (960, 540), 135
TARGET: dict[str, Any] = {"markers.target": {}}
SIDES_M, UP_M = {"wu": 0.4, "matsuo-target": 0.5}, 1.64  # of marks, and of the rope ends over A
PLACES_M = {"wu": (1.0, -0.45, UP_M), "matsuo-target": (-1.0, -0.45, UP_M)}
LIDAR = {"sensors.lidar0": {"model": "lidar", "rate_hz": 5.0}}
UPRIGHT = {"model": "camera", "width_px": 360, "height_px": 640, "focal_length_px": 600.0, "rate_hz": RATE_HZ}
BESIDE = {"mount": "jib-head", "position_m": [0.0, -22.0, -10.0], "azimuth_deg": 90.0, "elevation_deg": 3.0}
# side0 looks along the jib and side1 across it; three cameras on the platform look at balls.
SIDE: dict[str, Any] = {
    "side0": {"position_m": [2.0, -1.5, 14.0], "elevation_deg": 7.0},
    "side1": BESIDE,
    "away": {"position_m": [2.0, -1.5, 14.0], "elevation_deg": 7.0, "azimuth_deg": 40.0},
    "king0": {"position_m": [2.0, -4.0, 14.0], "elevation_deg": 20.0, "azimuth_deg": 10.0},
    "king1": {"position_m": [2.0, 0.0, 14.0], "elevation_deg": 20.0},
    "king2": {"position_m": [2.0, 4.0, 14.0], "elevation_deg": 20.0, "azimuth_deg": -10.0},
}
BALLS = {"markers.balls": {"distances_m": [2.0, 8.0]}}
CRANE_LEAN = np.radians(1.0)  # outboard, of the whole crane
PAGE = Path(__file__).resolve().parent.parent / "docs" / "results" / "rivals.md"

LEVEL: dict[str, Any] = {
    "camera.beta_deg": 0.0, "camera.offset_x_m": 0.0, "camera.offset_y_m": 0.0, "camera.offset_z_m": 0.0,
    "camera.mount": {"model": "fixed"},
}  # fmt: skip
LEVELLED = {"camera.mount": {"model": "levelled"}}
ACCELERATING = {"model": "turn", "slew_rpm": 0.6, "ramp_s": 6.0, "wait_s": 5.0}
WORKING = {"model": "cycles", "dig_rope_m": 22.0, "carry_rope_m": 10.0, "dig_s": 3.0, "operator": 1.0}
# Condition: scene, changes, and what the crane does.
CONDITIONS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "calm": ("free-swing", {}, {}),
    "tilt": ("free-swing", {"camera.beta_deg": 5.0}, {}),
    "offset": ("free-swing", {"camera.offset_y_m": 0.6, "camera.offset_z_m": -0.3}, {}),
    "accelerating": ("free-swing", {}, {"work": ACCELERATING}),
    "levelling": ("free-swing", LEVELLED, {"work": ACCELERATING}),
    "leaning": ("free-swing", {"camera.mount": {"model": "rigid"}}, {"work": WORKING}),
    "night": ("night-light-snow", {}, {}),
    "rain": ("rain", {}, {}),
    "wind": ("free-swing", {}, {"wind": {"mean_m_s": 14.0}}),
    "four-rope": ("free-swing", {"suspension": {"model": "four-rope"}}, {}),
}


def scenario(condition: str, clip: int, more: dict[str, Any] | None = None, size: tuple[int, int] = SIZE) -> Scenario:
    """Load the scene of one clip, with more changes."""
    scene, changes, crane = CONDITIONS[condition]
    rope = ROPES_M[clip % len(ROPES_M)]
    work: dict[str, Any] = dict(crane.get("work", {"model": "hang"}))
    if work["model"] != "cycles":
        work["rope_length_m"] = rope
    swing: dict[str, Any] = {
        "model": "dynamic", "damping": 0.005, "work": work,
        "start": {"alpha_deg": 6.0, "azimuth_deg": (30.0 + 70.0 * clip) % 360.0, "roundness": 0.3},
    }  # fmt: skip
    if "wind" in crane:
        swing["wind"] = crane["wind"]
    imus = {f"sensors.{mount.replace('-', '_')}": {"model": "imu", "mount": mount} for mount in MOUNTS}
    imus["sensors.camera"] |= {"noise": "mems"}
    others = {
        "sensors.tilt": {"model": "inclinometer", "mount": "rope"},
        "sensors.hoist": {"model": "hoist-encoder"},
    }
    every = {"frames": FRAMES, "seed": 300 + clip, "camera.tilt_azimuth_deg": 100.0 * clip % 360.0, "swing": swing}
    return simgrab.load(scene, {**LEVEL, **every, **imus, **others, **changes, **(more or {})}, size=size)


def sensors_of(scene: Scenario) -> tuple[Sensors, Array, Array]:
    """Record a clip's sensors; returns them, and the true α (n,), rad, at the frames' times (n,), s."""
    recorded = simgrab.sensors(scene)
    imus = {mount: imu_readings(recorded[mount.replace("-", "_")], scene) for mount in MOUNTS}
    tilt, hoist = recorded["tilt"], recorded["hoist"]
    time = np.arange(scene.frames) / RATE_HZ
    true = np.interp(time, recorded["rope"].true("time [s]"), np.radians(recorded["rope"].true("alpha [deg]")))
    camera = calibration_of(scene)
    found = Sensors(
        imus, Series(tilt.stamp_ns / 1e9, np.radians(tilt.values)), Series(hoist.stamp_ns / 1e9, hoist.values),
        offset_m=camera.offset_m,
    )  # fmt: skip
    return found, time, true


def imu_readings(recorded: Recording, scene: Scenario) -> ImuReadings:
    """Give what a recorded IMU reported, with the noise densities of its data sheet."""
    errors = scene.sensors[recorded.name].errors  # type: ignore[union-attr]
    return ImuReadings(
        recorded.stamp_ns / 1e9, recorded.values[:, :3], recorded.values[:, 3:], np.eye(3),
        errors.gyroscope_noise_density, errors.gyroscope_random_walk, errors.accelerometer_noise_density,
        errors.accelerometer_random_walk,
    )  # fmt: skip


def measure(condition: str, clip: int, part: str) -> dict[str, Any]:
    """Measure a clip by every method of a part: angles in degrees, None where there is none."""
    scene = scenario(condition, clip)
    sensors, time, true = sensors_of(scene)
    match part:
        case "sensors":
            found = {name: method(sensors, time).alpha for name, method in INERTIAL.items() if name != "jung"}
            found["constant-zero"] = np.zeros(MARKED_FRAMES)
        case "pictures":
            frames = [Frame(frame.rgb, frame.truth.time_s) for frame in simgrab.frames(scene)]
            found = _from_pictures(frames, calibration_of(scene), sensors, time)
        case "marks":
            found = _by_marks(condition, clip, sensors.lengths, MARKED_FRAMES)
        case "lidar":
            found = {"lidar": _by_lidar(condition, clip, time)}
        case "side":
            found = _from_the_side(condition, clip, sensors.lengths, time[:MARKED_FRAMES])
    degrees = {n: [None if np.isnan(x) else round(float(np.degrees(x)), 4) for x in a] for n, a in found.items()}
    return {"condition": condition, "clip": clip, "true": np.degrees(true).round(4).tolist(), "alpha": degrees}


def _by_marks(condition: str, clip: int, rope: Series, count: int) -> dict[str, Array]:
    """Measure with circles and a target, with layers measured at rest and with assumed ones, and with a tag."""
    circled = TARGET | {"markers.plate": {"model": "circles"}}
    frames, camera = _marked(condition, clip, circled)
    still = simgrab.frames(_at_rest(condition, clip, circled))
    rest = sorted(((frame.truth.rope_length_m, frame.rgb) for frame in still), key=lambda pair: pair[0])
    found = {}
    for name, find in FINDERS.items():
        seen = [(length, find(picture)) for length, picture in rest]
        measured = [RestMark(length, mark) for length, mark in seen if mark is not None]
        assumed = level_layers(camera, np.array(PLACES_M[name]), SIDES_M[name], [length for length, _ in rest])
        for suffix, layers in (("", assumed), ("-layers", measured)):
            method = Layered(name, find, layers, SIDES_M[name], UP_M, rope) if layers else None
            found[name + suffix] = np.full(count, np.nan) if method is None else _alpha(method(frames, camera))
    frames, camera = _marked(condition, clip, {"markers.plate": {"model": "apriltag"}})
    found["fiducial"] = _alpha(Fiducial(0.8, (1.0, -0.45, 0.0))(frames, camera))
    return found


def _marked(condition: str, clip: int, marks: dict[str, Any]) -> tuple[list[Frame], Calibration]:
    scene = scenario(condition, clip, marks | {"frames": MARKED_FRAMES}, MARKED_SIZE)
    return [Frame(frame.rgb, frame.truth.time_s) for frame in simgrab.frames(scene)], calibration_of(scene)


def _at_rest(condition: str, clip: int, marks: dict[str, Any]) -> Scenario:
    """Scene with the same camera and the grab hanging still, at ropes of several lengths."""
    scene, changes, _ = CONDITIONS[condition]
    tilt = {"camera.tilt_azimuth_deg": 100.0 * clip % 360.0, "seed": 300 + clip}
    steady = {key: value for key, value in changes.items() if key != "suspension"}
    still: dict[str, Any] = {
        "swing.model": "iid", "swing.alpha.sigma_deg": 0.0, "frames": 8,
        "swing.rope_length_m": {"dist": "uniform", "low": 9.5, "high": 23.0},
        "swing.yaw_deg": {"dist": "constant", "value": 0.0}, "swing.jaw_deg": {"dist": "constant", "value": 0.0},
        "swing.load": {"dist": "constant", "value": 0.0},
    }  # fmt: skip
    base = "quay-day" if scene == "free-swing" else scene
    return simgrab.load(base, {**LEVEL, **tilt, **steady, **still, **marks}, size=MARKED_SIZE)


def _by_lidar(condition: str, clip: int, time: Array) -> Array:
    """Measure with the LiDAR, after half a second of scans of the hanging grab."""
    scene = scenario(condition, clip, LIDAR)
    still = {
        "swing.start.alpha_deg": 0.0,
        "swing.work": {"model": "hang", "rope_length_m": ROPES_M[clip % len(ROPES_M)]},
    }
    rest = scenario(condition, clip, LIDAR | still | {"frames": 5})
    return lidar(_scans(scene), _scans(rest), time, scene.jib.head_height_m).alpha


def _scans(scene: Scenario) -> Scans:
    recorded = simgrab.sensors(scene)["lidar0"]
    assert recorded.body_from_sensor is not None
    return Scans.of(recorded.stamp_ns, recorded.values[:, :3].astype(float), recorded.body_from_sensor)


def _from_the_side(condition: str, clip: int, rope: Series, time: Array) -> dict[str, Array]:
    """Measure with ropes and balls in pictures from the side; with a lean that calibrations do not know too."""
    cameras = {f"sensors.{name}": UPRIGHT | camera for name, camera in SIDE.items()}
    scene = scenario(condition, clip, BALLS | cameras | {"frames": MARKED_FRAMES})
    with tempfile.TemporaryDirectory() as folder:
        sensor_files.write(Recipe(scene), into(Path(folder)))
        platform = (-scene.swing.radius_m, 0.0, -scene.jib.head_height_m)  # type: ignore[union-attr]
        view = {
            name: read_view(Path(folder, "sensors", "clip_000", name), (0, 0, 0) if "mount" in camera else platform)
            for name, camera in SIDE.items()
        }
        pair, three = [view["side0"], view["side1"]], [view[f"king{i}"] for i in range(3)]
        found = {
            "okubanjo": okubanjo(pair, rope, time),
            "okubanjo-one": okubanjo(pair[:1], rope, time),
            "okubanjo-lean": okubanjo([_leaning(one) for one in pair], rope, time),
            "okubanjo-away": okubanjo([view["away"], view["side1"]], rope, time),
            "tysse": tysse(three, rope, time),
            "tysse-lean": tysse([_leaning(one) for one in three], rope, time),
            "tysse-away": tysse([three[0], view["away"]], rope, time),
        }
    return {name: swing.alpha for name, swing in found.items()}


def _leaning(view: SideView) -> SideView:
    """Calibrate a camera as on a level crane where the whole crane leans: the frame leans about O with all in it."""
    lean = rotation_y(CRANE_LEAN)
    return replace(view, rotation=lean @ view.rotation, centre=lean @ view.centre)


def _from_pictures(frames: list[Frame], camera: Calibration, sensors: Sensors, time: Array) -> dict[str, Array]:
    """Measure with the rivals' cameras, and with simgrab's own estimators and detector."""
    rope = sensors.lengths
    rivals = (kawai(), matsuo(), optical_flow(rope))
    found = {instrument.name: _alpha(instrument(frames, camera)) for instrument in rivals}
    followed = list(template()(frames))
    if sum(one.centre is not None for one in followed) >= 2:
        seen = replace(sensors, target=target_angles(followed, camera))
        found["jung"] = INERTIAL["jung"](seen, time).alpha
    places = list(observe(frames, detector(), None, camera))
    own: dict[str, Estimator] = {
        "rope-aware": RopeAware(), "inertial-fusion": InertialFusion(imu=sensors.imu("camera"))
    }  # fmt: skip
    return found | {name: _alpha(conclude(places, camera, estimator, rope)) for name, estimator in own.items()}


def _alpha(measurements: Any) -> Array:
    return np.array([np.nan if m.alpha is None else m.alpha for m in measurements])


@click.group()
def main() -> None:
    """Measure the rivals, and write the page."""


@main.command()
@click.option("--condition", "conditions", multiple=True, type=click.Choice(list(CONDITIONS)), help="[default: all]")
@click.option("--part", type=click.Choice(PARTS), required=True, help="What the methods look at.")
@click.option("--clips", "count", default=2, show_default=True, help="Clips of each condition.")
@click.option("--out", type=Path, default=Path("runs/rivals"), show_default=True)
def clips(conditions: tuple[str, ...], part: str, count: int, out: Path) -> None:
    """Make clips and measure them; files that are there are kept."""
    out.mkdir(parents=True, exist_ok=True)
    for clip in range(count):
        for condition in conditions or CONDITIONS:
            file = out / f"{condition}-{clip}-{part}.json"
            if not file.exists():
                file.write_text(json.dumps(measure(condition, clip, part)))
                click.echo(f"{datetime.now(UTC):%H:%M:%S} {file}")


def figures(files: list[dict[str, Any]], method: str) -> tuple[float, float, float, float] | None:
    """RMSE of α, ends of its 95 % interval by blocks of clips, and the share of frames with an angle; degrees."""
    squares, answered, frames = [], 0, 0
    for one in files:
        if method not in one["alpha"]:
            continue
        alpha = np.array([np.nan if a is None else a for a in one["alpha"][method]])
        error = alpha - np.array(one["true"][: len(alpha)])
        each = int(BLOCK_S * RATE_HZ)
        squares += [error[i : i + each] ** 2 for i in range(0, len(error), each)]
        answered, frames = answered + int(np.isfinite(alpha).sum()), frames + len(alpha)
    if not frames:
        return None
    if not answered:
        return np.nan, np.nan, np.nan, 0.0
    sums = np.array([[np.nansum(s), np.isfinite(s).sum()] for s in squares])
    draws = np.random.default_rng(0).integers(len(sums), size=(REPLICATIONS, len(sums)))
    total = sums[draws].sum(axis=1)
    low, high = np.quantile(np.sqrt(total[:, 0] / np.maximum(total[:, 1], 1)), [0.025, 0.975])
    whole = sums.sum(axis=0)
    return float(np.sqrt(whole[0] / whole[1])), float(low), float(high), answered / frames


METHODS = (
    "constant-zero", "kawai", "matsuo", "matsuo-target", "matsuo-target-layers", "wu", "wu-layers", "fiducial",
    "optical-flow", "accelerometer-grab", "accelerometer-rope", "ahrs-grab", "gao", "gyro-pendulum", "schaper", "kim",
    "jung", "lidar", "okubanjo", "okubanjo-one", "okubanjo-lean", "okubanjo-away", "tysse", "tysse-lean", "tysse-away",
    "rope-aware", "inertial-fusion",
)  # fmt: skip


def rows(files: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of the table."""
    names = [name for name in CONDITIONS if any(one["condition"] == name for one in files)]
    yield "| method | " + " | ".join(names) + " |"
    yield "|---|" + "---|" * len(names)
    for method in METHODS:
        cells = [f"`{method}`"]
        for name in names:
            found = figures([one for one in files if one["condition"] == name], method)
            if found is None:
                cells.append("–")
            elif found[3] == 0:
                cells.append("no angle")
            else:
                rmse, low, high, share = found
                cells.append(f"{rmse:.2f} ({low:.2f}–{high:.2f})" + ("" if share > 0.985 else f", {100 * share:.0f} %"))
        yield "| " + " | ".join(cells) + " |"


@main.command()
@click.option("--out", type=Path, default=Path("runs/rivals"), show_default=True)
def page(out: Path) -> None:
    """Write the table between the marks of docs/results/rivals.md, or print it where there is no such page."""
    files = [json.loads(file.read_text()) for file in sorted(out.glob("*.json"))]
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True).stdout
    made = [f"Recorded in commit `{commit.strip()}`, {datetime.now(UTC):%Y-%m-%d}.", "", *rows(files)]
    if not PAGE.exists():
        click.echo("\n".join(made))
        return
    begin, end = "<!-- table -->\n", "\n<!-- end of the table -->"
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(begin)
    _, _, tail = rest.partition(end)
    PAGE.write_text(head + begin + "\n".join(made) + end + tail, encoding="utf-8")


if __name__ == "__main__":
    main()
