"""A complete scene, and how scenarios are read, changed and written."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import timedelta
from itertools import pairwise
from typing import Annotated, Any, Literal

import msgspec
import tomli_w

from simgrab.errors import LayoutError, ScenarioError
from simgrab.io import models
from simgrab.model.distributions import AnyDistribution, Constant
from simgrab.model.geometry import Intrinsics
from simgrab.model.layouts import Layout
from simgrab.model.scenario.base import Meta, OfFile, Strict, about
from simgrab.model.scenario.camera import Camera
from simgrab.model.scenario.factor import JOINT, Factor, OneOf
from simgrab.model.scenario.grab import FourRope, Grab, Mesh
from simgrab.model.scenario.markers import Markers
from simgrab.model.scenario.optics import Optics
from simgrab.model.scenario.output import Clip, Display, Image, Labels, Shutter, Splits
from simgrab.model.scenario.sensors import MotionSensor
from simgrab.model.scenario.surroundings import Clutter, Jib, Light, Photo, Place, Quay
from simgrab.model.scenario.suspension import DoublePendulum, OneBody, Suspension
from simgrab.model.scenario.swing import ROPE_LENGTH_RANGE_M, Cycles, Dynamic, Iid
from simgrab.model.scenario.weather import Weather

Name = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]*\Z", max_length=64)]
MOST_DAYS = 366
"""Of simulated motion in a dataset."""
MOST_SENSORS = 32
_WHERE_SET = (
    ("", "suspension"), ("", "markers"), ("", "sensors"), ("", "every"), ("display", "font"), ("labels", "yolo"),
    ("optics", "sharpening"), ("optics", "white_balance"),
)  # fmt: skip
"""Keys by table that are written, and digested, only where they are not as by default."""
_SENSOR_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")  # a folder of the dataset


class Scenario(Strict, frozen=True):
    """One scene, whole. Two scenarios with the same `digest` give the same dataset.

    ``vary`` draws keys anew for each clip: by dotted key, or by several joined with ``+``, a law or a choice. A key
    that only some kinds of a table have is left out where another kind was drawn. ``every`` says of tables how many
    frames share a draw, where that is more than one clip: what is slow to build can be drawn less often.

    Some keys are written, and digested, only where they are not as by default: the first-level ones ``sensors``,
    ``suspension``, ``markers`` and ``every``, the display's font, the labels' ``yolo``, and the optics' sharpening and
    white balance.
    """

    name: Annotated[Name, about("Name of the scene; the default output folder is runs/NAME.")] = "custom"
    description: Annotated[str, about("One sentence on what the scene shows.", max_length=10_000)] = ""
    seed: Annotated[int, about("Seed of all random draws.", ge=0, le=2**53)] = 0
    frames: Annotated[int, about("Number of frames.", ge=1, le=10_000_000)] = 64
    camera: Annotated[Camera, about("The surveillance camera at the jib head.")] = Camera()
    swing: Annotated[Iid | Dynamic, about("How the grab swings: independent draws, or physics.")] = Iid()
    grab: Annotated[Grab, about("The grab: its kind, shape and appearance.")] = FourRope()
    jib: Annotated[Jib, about("The jib head and its ropes.")] = Jib()
    place: Annotated[Place, about("What lies below the grab.")] = Quay()
    clutter: Annotated[Clutter, about("Parked grabs of other cranes.")] = Clutter()
    light: Annotated[Light, about("Sun, sky and floodlights.")] = Light()
    optics: Annotated[Optics, about("Lens, exposure and sensor effects.")] = Optics()
    weather: Annotated[Weather, about("Fog, rain, snow, dust, wet ground and the cover glass.")] = Weather()
    image: Annotated[Image, about("How frames are rendered and stored.")] = Image()
    shutter: Annotated[Shutter, about("Exposure time and rolling shutter.")] = Shutter()
    clip: Annotated[Clip, about("Frame rate, clips, and video coding.")] = Clip()
    display: Annotated[Display, about("The on-screen display: clock and rope lengths.")] = Display()
    labels: Annotated[Labels, about("Detection labels: of which frames, and of which kind.")] = Labels()
    splits: Annotated[Splits, about("Shares of train, val and test.")] = Splits()
    suspension: Annotated[Suspension, about("How the grab hangs on its ropes.")] = OneBody()
    markers: Annotated[Markers, about("What is mounted for a method to look at.")] = Markers()
    sensors: Annotated[dict[str, MotionSensor], about("Sensors beside the camera, by name; they need physics.")] = (
        msgspec.field(default_factory=dict)
    )
    vary: Annotated[
        dict[str, Factor], about("Keys that are drawn for each clip, each from a distribution or a choice.")
    ] = msgspec.field(default_factory=dict)
    every: Annotated[
        dict[str, Annotated[int, Meta(ge=1, le=10_000_000)]],
        about("Frames that share a draw, by table: a multiple of clip.clip_frames, which is the default."),
    ] = msgspec.field(default_factory=dict)

    def check(self) -> None:  # noqa: D102
        if isinstance(self.swing, Iid):
            _within("swing.rope_length_m", self.swing.rope_length_m, *ROPE_LENGTH_RANGE_M)
            _within("swing.load", self.swing.load, 0.0, 1.0)
            _within("swing.jaw_deg", self.swing.jaw_deg, 0.0, math.inf)
            if self.camera.mount.vibration.rms_deg > 0:
                raise ScenarioError(
                    "camera.mount.vibration", 'independent frames have no time; set swing.model = "dynamic"'
                )
        else:
            self._check_duration(self.swing)
            if isinstance(self.grab, Mesh) and not isinstance(self.swing.work, Cycles) and self.swing.work.load:
                raise ScenarioError(
                    "swing.work.load",
                    "must be 0, as a grab from a file holds no load; its mass with cargo may be grab.mass_kg",
                )
        _check_lens(self.camera.intrinsics)
        if self.shutter.open_s * self.clip.frame_rate_hz > 1:
            raise ScenarioError(
                "shutter",
                f"exposure_s + rolling_s = {self.shutter.open_s:g} s is longer than a frame at "
                f"{self.clip.frame_rate_hz:g} Hz",
            )
        if isinstance(self.place, Photo) and self.light.floodlights > 0:
            raise ScenarioError("light.floodlights", 'must be 0 with place.model = "photo", which has its own light')
        self._check_display()
        self._check_sensors()
        for key in self.vary:
            for part in key.split(JOINT):
                table, _, last = part.rpartition(".")
                if table in ("grab", "place", "display.font") and last in ("file", "sha256"):
                    raise ScenarioError(f"vary.{key}", f"a file varies with its table: use [vary.{table}]")
        if self.vary and not self.clip.clip_frames:
            raise ScenarioError("clip.clip_frames", "vary draws new values for each clip: set clip.clip_frames")
        self._check_every()

    def _check_every(self) -> None:
        drawn = {part.partition(".")[0] for key in self.vary for part in key.split(JOINT)}
        for table, frames in self.every.items():
            if table not in drawn:
                known = ", ".join(sorted(drawn)) or "nothing"
                raise ScenarioError(f"every.{table}", f"nothing of this table varies; {known} does")
            if frames % self.clip.clip_frames:
                clip = self.clip.clip_frames
                raise ScenarioError(f"every.{table}", f"must be a multiple of clip.clip_frames ({clip}), got {frames}")
        levels = sorted(self.every, key=self.every.__getitem__)
        for fine, rough in pairwise(levels):  # else worlds of two splits would share a draw
            if self.every[rough] % self.every[fine]:
                own, other = self.every[rough], self.every[fine]
                raise ScenarioError(f"every.{rough}", f"must be a multiple of every.{fine} ({other}), got {own}")

    def draw_of(self, clip: int, *tables: str) -> int:
        """Return which draw of tables that are drawn together a clip shows: clips share one for ``every`` frames."""
        frames = max(self.every.get(table, 1) for table in tables)
        return clip // max(frames // max(self.clip.clip_frames, 1), 1)

    def slowest_draw(self, clip: int) -> int:
        """Return which draw a clip shows of the table that is drawn least often: others of it are alike."""
        return self.draw_of(clip, *self.every) if self.every else clip

    def _check_duration(self, swing: Dynamic) -> None:
        days = (self.frames / self.clip.frame_rate_hz + self.clip_count * swing.settle_s) / 86_400
        if days > MOST_DAYS:
            raise ScenarioError(
                "frames",
                f"{self.frames} frames, and swing.settle_s before each clip, need {days:.0f} days of physics; "
                f"at most {MOST_DAYS} are simulated",
            )

    def _check_display(self) -> None:
        try:
            _ = self.display_layout
            self.display.started + timedelta(seconds=self.frames / self.clip.frame_rate_hz)
        except LayoutError as problem:
            raise ScenarioError("display.layout", str(problem)) from None
        except OverflowError:
            raise ScenarioError("display.start", "its clock ends with the year 9999, before the last frame") from None

    def _check_sensors(self) -> None:
        if len(self.sensors) > MOST_SENSORS:
            raise ScenarioError("sensors", f"at most {MOST_SENSORS} sensors, got {len(self.sensors)}")
        for name in self.sensors:
            if not _SENSOR_NAME.fullmatch(name):
                raise ScenarioError(
                    f"sensors.{name}",
                    "a name has 1 to 64 of a-z, 0-9, _ and -, and begins with a letter or digit",
                )
        if isinstance(self.swing, Iid) and isinstance(self.suspension, DoublePendulum):
            raise ScenarioError(
                "suspension.model", 'independent frames cannot have it; set swing.model = "dynamic", or another model'
            )
        if self.sensors and isinstance(self.swing, Iid):
            raise ScenarioError("sensors", 'independent frames have no motion to measure; set swing.model = "dynamic"')

    def with_camera(self, camera: Camera) -> Scenario:
        """Return the same world seen by another camera, without display."""
        return msgspec.structs.replace(self, camera=camera, display=Display(layout="none"))

    @property
    def clip_count(self) -> int:
        """Number of clips."""
        return self.clip.count(self.frames)

    def span(self, clip: int) -> range:
        """Frames of one clip, in order; the last clip may be shorter."""
        return self.clip.span(clip, self.frames)

    @property
    def display_layout(self) -> Layout | None:
        """The display's layout fitted to the picture; None where there is no display."""
        return self.display.layout_in(self.camera.width_px, self.camera.height_px)

    @property
    def models(self) -> tuple[models.ModelFile, ...]:
        """Models of users' own grabs, and users' photographs and fonts, that are known in this process."""
        tables = [self.grab, self.place, *self.clutter.kinds, self.display.font, *self.vary.values()]
        named = dict.fromkeys(_models(tables))
        return tuple(model for name, sha256 in named if (model := models.find(sha256, name)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the models, so that another process, or machine, knows them."""
        return _unpickled, (msgspec.structs.astuple(self), [(one.name, dict(one.files)) for one in self.models])

    def digest(self) -> str:
        """SHA-256 of the canonical JSON of everything in the scenario."""
        return hashlib.sha256(msgspec.json.encode(self._stated("deterministic"))).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as JSON and TOML have them."""
        return dict(msgspec.json.decode(msgspec.json.encode(self._stated(None))))

    def _stated(self, order: Literal["deterministic"] | None) -> dict[str, Any]:
        plain, usual = (msgspec.to_builtins(scenario, order=order) for scenario in (self, Scenario()))
        for table, key in _WHERE_SET:
            own, default = (data[table] if table else data for data in (plain, usual))
            if own[key] == default[key]:
                del own[key]
        return dict(plain)

    def to_toml(self) -> str:
        """Return a scene file with every key filled in."""
        return tomli_w.dumps(without_none(self.to_dict()))


def _unpickled(fields: tuple[Any, ...], known: Iterable[tuple[str, dict[str, bytes]]]) -> Scenario:
    for name, files in known:
        models.remember(models.ModelFile(name, files))
    return Scenario(*fields)


def _models(values: Iterable[Any]) -> Iterator[tuple[str, str]]:
    """Give name and SHA-256 of all models in tables, plain or not."""
    for value in values:
        match value:
            case OfFile():
                yield value.file, value.sha256
            case {"file": str(file), "sha256": str(sha256)}:
                yield file, sha256
            case OneOf():
                yield from _models(value.values)
            case dict():
                yield from _models(value.values())
            case list() | tuple():
                yield from _models(value)


def without_none(value: Any) -> Any:
    """Leave out what is null in tables, however deep: TOML knows no null, and an absent key says the same."""
    if isinstance(value, dict):
        return {key: without_none(inner) for key, inner in value.items() if inner is not None}
    return [without_none(inner) for inner in value] if isinstance(value, list) else value


def _within(key: str, law: AnyDistribution, low: float, high: float) -> None:
    least, most = law.support()
    if least < low or most > high:
        got = f"got {least:g}" if least == most else f"this distribution spans {least:g} … {most:g}"
        raise ScenarioError(key, f"values must stay within {low:g} … {high:g}, {got}")


def _check_lens(intrinsics: Intrinsics) -> None:
    """Refuse a lens that folds within the picture."""
    w, h = intrinsics.width_px, intrinsics.height_px
    border = [(x, y) for x in (0, w / 2, w) for y in (0, h / 2, h)]
    if any(map(math.isnan, intrinsics.undistort(border).ravel())):
        raise ScenarioError("camera.distortion", "the distortion is not invertible: no ray maps to the image corners")


def schema() -> dict[str, Any]:
    """JSON schema of a scenario file, for editors."""
    schema = msgspec.json.schema(Scenario)
    tables = schema["$defs"]
    tables["Scenario"]["properties"]["base"] = {
        "description": "Bundled scene that this file departs from.", "type": "string",
    }  # fmt: skip
    for tag, table in ((tag, table.get("properties", {})) for tag in ("model", "dist") for table in tables.values()):
        if tag in table:
            table[tag]["description"] = "Selects this kind."
    return dict(_with_numbers(schema))


def _with_numbers(schema: Any) -> Any:
    """Admit a number wherever a constant distribution may stand; JSON schema writes the end of a text as ``$``."""
    if isinstance(schema, list):
        return [_with_numbers(part) for part in schema]
    if not isinstance(schema, dict):
        return schema.replace(r"\Z", "$") if isinstance(schema, str) else schema
    result = {key: _with_numbers(part) for key, part in schema.items()}
    if {"$ref": f"#/$defs/{Constant.__name__}"} in result.get("anyOf", ()):
        result["anyOf"].append({"type": "number"})
    return result


def merged(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested tables, ``change`` winning; a table with ``dist``, or of another ``model``, replaces the old one."""
    result = dict(base)
    for key, value in change.items():
        old = result.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping) and not _replaces(old, value):
            result[key] = merged(old, value)
        else:
            result[key] = value
    return result


def difference(base: Mapping[str, Any], whole: Mapping[str, Any]) -> dict[str, Any]:
    """Return the change with which `merged` turns ``base`` into ``whole``.

    Null or missing values are left out, but for those of a table with ``dist``, which is then returned whole.
    """
    kept = {}
    for key, value in whole.items():
        old = base.get(key)
        if value is not None and value != old:
            alike = isinstance(old, Mapping) and isinstance(value, Mapping) and not _other_kind(old, value)
            if alike and not ("dist" in value and without_none(old).keys() - without_none(value)):
                kept[key] = difference(old, value)  # type: ignore[arg-type]
            else:
                kept[key] = without_none(value)
    return kept


def _replaces(old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    return ("dist" in old and "dist" in new) or _other_kind(old, new)


def _other_kind(old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    # Tables without the tag, such as those of `--set place.cargo=ore`, may be of any kind.
    return any(tag in old and tag in new and new[tag] != old[tag] for tag in ("model", "dist"))
