"""``simgrab new``."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import click

from simgrab.cli import _lenses
from simgrab.cli._options import PATH, together

T = TypeVar("T")
GRABS = ("four-rope", "clamshell", "orange-peel", "scissors")
LIGHTS: Mapping[str, tuple[float, str]] = {"day": (0.0, "off"), "night": (-1.3, "on")}
"""Exposure in stops from the target, and the grey night mode."""
WEATHERS: Mapping[str, tuple[float, float, Mapping[str, float]]] = {
    "clear": (1.0, 0.85, {}),
    "rain": (0.0, 0.6, {"rain_mm_h": 8.0, "wetness": 0.8, "lens_drops": 8}),
    "fog": (0.0, 0.8, {"visibility_m": 100.0, "wetness": 0.2}),
    "snow": (0.0, 0.75, {"snow_mm_h": 0.6, "snow_cover": 0.25}),
    "dust": (0.8, 0.85, {"dust_thickness": 1.8, "dust_radius_m": 2.5, "lens_dirt": 0.03}),
}
"""Light of sun and sky by day, and keys of the weather."""
JOINT = "light+optics.exposure.exposure_ev+optics.night_mode+weather"
CYCLE_S = 75
# Question, and what stands for an answer.
ASKED = {
    "camera": ("Model of the camera (empty: give sensor and lens)", ""),
    "sensor": ('Sensor: format (1/2.8), name (IMX335) or active size in mm (5.57x3.13)', "1/2.8"),
    "lens": ("Focal length of the lens, mm", "4"),
    "size": ("Size of the picture, px", "1920x1080"),
    "fov": ("Field of view on the data sheet, across or across x up in degrees, such as 84x45 (empty: not known)", ""),
    "rate": ("Pictures a second", "25"),
    "offset": ("Camera from the rope exit: outboard, sideways, up, in m", "0,0.6,-0.3"),
    "tilt": ("Tilt of the camera from the vertical, degrees", "3"),
    "height": ("Height of the jib head above the quay, m", "28"),
    "ropes": ("Shortest and longest rope, m", "8..22"),
    "grab": (f"Grab: {', '.join(GRABS)}, or the file of a 3-D model", "four-rope"),
    "volume": ("Volume of the grab, m³", "6"),
    "mount": ("Mount: levelled (hangs by gravity), rigid (pitches with the jib) or fixed", "levelled"),
    "light": (f"Light, one or more of: {', '.join(LIGHTS)}", "day"),
    "weather": (f"Weather, one or more of: {', '.join(WEATHERS)}", "clear"),
    "motion": ("Motion: independent (frames to train on) or cycles (video of a working crane)", "independent"),
}  # fmt: skip


@click.command(name="new")
@click.argument("file", type=PATH)
@together(*(click.option(f"--{name}", metavar="TEXT", help=f"{text}.") for name, (text, _) in ASKED.items()))
@click.option("--yes", is_flag=True, help="Ask nothing: take the usual for what is not given.")
def command(file: Path, yes: bool, **given: str | None) -> None:
    """Write a scene FILE from what you know of your camera, crane and grab.

    At a terminal it asks for what is not given; elsewhere, or with --yes, it takes the usual and says so.
    """
    from simgrab.errors import ScenarioError
    from simgrab.io import files
    from simgrab.io.destination import check_new_folder, writing
    from simgrab.model import scenes
    from simgrab.text import printable

    def refuse(problem: str) -> ScenarioError:
        return ScenarioError("", problem)

    check_new_folder(file, refuse, "FILE")
    answers = _Answers(given, ask=not yes and sys.stdin.isatty())
    text = _scene(answers, file)
    with writing(file, refuse), files.drafted(file) as draft:
        draft.write_text(text, encoding="utf-8")
        scenes.load(draft)
    shown = printable(file)
    for line in (f"{shown}: assumed", *(f"  {line}" for line in answers.assumed), f"look: simgrab studio {shown}"):
        click.echo(line)


class _Answers:
    """What the user says, by option or when asked; `assumed` collects what nobody said."""

    def __init__(self, given: Mapping[str, str | None], *, ask: bool) -> None:
        self._given, self._ask = given, ask
        self.assumed: list[str] = []

    def get(self, name: str, read: Callable[[str], T], usual: str | None = None) -> T:
        """Read an answer; ``read`` raises ValueError for nonsense."""
        question, default = ASKED[name][0], ASKED[name][1] if usual is None else usual
        text = self._given[name]
        if text is None and self._ask:
            return click.prompt(question, default, value_proc=lambda answer: self._read(name, answer, read))
        if text is None:
            if default:
                self.assumed.append(f"--{name} {default}: {question[0].lower()}{question[1:]}")
            text = default
        return self._read(name, text, read)

    def has(self, name: str) -> bool:
        return self._given[name] is not None

    def _read(self, name: str, text: str, read: Callable[[str], T]) -> T:
        try:
            return read(text.strip())
        except ValueError as problem:
            raise click.BadParameter(str(problem), param_hint=f"--{name}") from None


def _numbers(text: str, low: float, high: float, count: int = 1) -> tuple[float, ...]:
    parts = [part for part in re.split(r"\.\.|[,;x×\s]+", text.replace("°", "")) if part]
    try:
        values = tuple(map(float, parts))
    except ValueError:
        values = ()
    if len(values) != count or not all(low <= value <= high for value in values):
        what = "a number" if count == 1 else f"{count} numbers"
        raise ValueError(f"needs {what} from {low:g} to {high:g}, got {text!r}")
    return values


def _number(low: float, high: float) -> Callable[[str], float]:
    return lambda text: _numbers(text, low, high)[0]


def _of(valid: Sequence[str], most: int = 99) -> Callable[[str], list[str]]:
    def read(text: str) -> list[str]:
        words = list(dict.fromkeys(word for word in re.split(r"[,\s]+", text.lower()) if word))
        if not 1 <= len(words) <= most or not set(words) <= set(valid):
            raise ValueError(f"must be {'one' if most == 1 else 'one or more'} of {', '.join(valid)}; got {text!r}")
        return words

    return read


def _camera_named(text: str) -> str:
    wanted = re.sub(r"[^a-z0-9]", "", text.lower())
    found = [name for name in _lenses.CAMERAS if wanted in re.sub(r"[^a-z0-9]", "", name.lower())]
    if wanted and len(found) != 1:
        raise ValueError(
            f"{'several are' if found else 'none is'} called {text!r}; give --sensor and --lens, or one of: "
            + ", ".join(found or _lenses.CAMERAS)
        )
    return found[0] if wanted else ""


def _fov(text: str) -> tuple[float, ...]:
    return _numbers(text, 5, 130, 2 if re.search(r"\d\D+\d", text.replace(".", "")) else 1) if text else ()


def _size(text: str) -> tuple[int, int]:
    width, height = _numbers(text, 64, 4096, 2)
    return int(width), int(height)


def _sensor(text: str, width_px: int, height_px: int) -> tuple[str, float, int, int]:
    """Name, width in mm and pixels of a sensor."""
    if name := _lenses.sensor(text, width_px, height_px):
        size, pitch_um, wide, high = _lenses.SENSORS[name]
        return f'{size}" sensor as {name}', pitch_um * wide / 1000, wide, high
    try:
        across, up = _numbers(text, 0.5, 40, 2)
    except ValueError:
        formats = dict.fromkeys(size for size, *_ in _lenses.SENSORS.values())
        raise ValueError(
            f"must be a format ({', '.join(formats)}), a name ({', '.join(_lenses.SENSORS)}) or mm x mm; got {text!r}"
        ) from None
    return f"sensor of {across:g} x {up:g} mm", across, width_px, round(width_px * up / across)


def _optics(answers: _Answers) -> tuple[str, int, int, float, float]:
    """Name of the optics, size of the picture, focal length in px, and barrel distortion."""
    camera = answers.get("camera", _camera_named)
    wide, high, lenses = _lenses.CAMERAS.get(camera, (1920, 1080, {}))
    width, height = answers.get("size", _size, f"{wide}x{high}")
    fov = () if camera and not answers.has("fov") else answers.get("fov", _fov)
    name, c, f_px = "field of view as given", _lenses.BARREL, 0.0
    if camera and not fov:
        mm = answers.get("lens", _number(0.5, 100), f"{max(lenses):g}")
        if mm not in lenses:
            have = " or ".join(f"{one:g}" for one in lenses)
            raise click.BadParameter(f"{camera} has a lens of {have} mm; got {mm:g}", param_hint="--lens")
        name, fov = f"{camera}, {mm:g} mm", lenses[mm]
    elif not fov:
        sensor, width_mm, wide, high = answers.get("sensor", lambda text: _sensor(text, width, height))
        mm = answers.get("lens", _number(0.5, 100))
        name, f_px = f"{sensor}, {mm:g} mm", mm / width_mm * wide
    else:
        wide, high = width, height
    part = max(width / wide, height / high)  # a picture of another shape is a part of the whole
    try:
        if len(fov) == 2:
            c = _lenses.barrel(wide, high, *fov)
        else:
            answers.assumed.append("--fov: barrel distortion as usual for surveillance lenses")
        f_px = part * (_lenses.focal_px(wide, fov[0], c) if fov else f_px)
        across = _lenses.across_deg(width, f_px, c)
    except ValueError as problem:
        raise click.BadParameter(str(problem), param_hint="--fov" if answers.has("fov") else "--lens") from None
    up = _lenses.vertical_deg(width, height, across, c)
    return f"{name}: {across:.0f} x {up:.0f} degrees", width, height, f_px, c


def _scene(answers: _Answers, file: Path) -> str:
    """Text of the scene file."""
    optics, width, height, f_px, c = _optics(answers)
    try:
        k1, k2, k3 = _lenses.brown(width, height, f_px, c)
    except ValueError as problem:
        raise click.BadParameter(str(problem), param_hint="--lens") from None
    rate = answers.get("rate", _number(0.1, 120))
    x, y, z = answers.get("offset", lambda text: _numbers(text, -3, 3, 3))
    tilt = answers.get("tilt", _number(0, 28))
    head = answers.get("height", _number(22, 35))
    short, long = answers.get("ropes", lambda text: _numbers(text, 6, 45, 2))
    if short >= long:
        raise click.BadParameter(
            f"the longest rope must be above the shortest, got {short:g} and {long:g}", param_hint="--ropes"
        )
    grab, volume = _grab(answers, file)
    mount = answers.get("mount", _of(("levelled", "rigid", "fixed"), 1))[0]
    moods = list(
        itertools.product(answers.get("light", _of(tuple(LIGHTS))), answers.get("weather", _of(tuple(WEATHERS))))
    )
    cycles = answers.get("motion", _of(("independent", "cycles"), 1)) == ["cycles"]
    deep = long > head - 3
    if cycles and deep:
        raise click.BadParameter(
            f"cycles dig on the quay, where ropes reach {head - 3:g} m; got {long:g}: raise --height or shorten it",
            param_hint="--ropes",
        )
    if deep:
        answers.assumed.append(f"place: an empty hold, because {long:g} m of rope reach below the quay")
    clip = round(CYCLE_S * rate) if cycles else 8
    lines = [
        "# Written by simgrab new from the facts below. simgrab scenes show prints every other key with its value.",
        'base = "quay-day"',
        f'name = "{re.sub("[^a-z0-9_-]+", "-", file.stem.lower()).strip("-_")[:64] or "port"}"',
        f"frames = {2 * clip if cycles else 200}",
        "",
        f"[camera] # {optics}",
        f"width_px = {width}",
        f"height_px = {height}",
        f'focal = {{ model = "pixels", focal_length_px = {f_px:.1f} }} # in the middle of the picture',
        f"distortion = {{ k1 = {k1}, k2 = {k2}, k3 = {k3} }} # spans that field of view; calibrate to replace it",
        f"beta_deg = {tilt:g} # tilt from the vertical",
        f"offset_x_m = {x:g} # from the rope exit: outboard",
        f"offset_y_m = {y:g} # sideways",
        f"offset_z_m = {z:g} # up",
        f'mount = {{ model = "{mount}" }}{"" if cycles else " # acts on motion; independent frames have none"}',
        "",
        "[jib]",
        f"head_height_m = {head:g}",
        "",
        "[swing]",
        *(
            ['model = "dynamic"', f'work = {{ model = "cycles", dig_rope_m = {long:g}, carry_rope_m = {short:g} }}']
            if cycles
            else [
                f'rope_length_m = {{ dist = "uniform", low = {short:g}, high = {long:g} }}',
                "clamp = true # ropes end above the ground, jaws open as far as they go",
            ]
        ),
        *(["", "[place]", 'model = "hold"', "depth_m = 18.0", "fill = 0.0"] if deep else []),
        "",
        *grab,
        "",
        "[clip]",
        f"frame_rate_hz = {rate:g}",
        f"clip_frames = {clip} # then [vary] draws anew",
        "",
        "[optics]",
        "vignetting_stops = 1.0",
        *_mood(moods, rate),
        "",
        "[vary] # tolerances of the facts above",
        *_tolerance("camera.focal.focal_length_px", f_px, 0.01 * f_px),
        *_tolerance("camera.beta_deg", tilt, 2, 0, 30),
        '"camera.tilt_azimuth_deg" = { dist = "uniform", low = -180, high = 180 }',
        *_tolerance("camera.roll_deg", 0, 3),
        *_tolerance("camera.offset_x_m", x, 0.1, -3, 3),
        *_tolerance("camera.offset_y_m", y, 0.1, -3, 3),
        *_tolerance("camera.offset_z_m", z, 0.1, -3, 1),
        *_tolerance("jib.head_height_m", head, 0.5, 22, 35),
        *(_tolerance("grab.volume_m3", volume, 0.1 * volume, 3, 20) if volume else []),
        *(
            ['"light.sun_azimuth_deg" = { dist = "uniform", low = -180, high = 180 }']
            if ("day", "clear") in moods
            else []
        ),
        *([] if "mesh" in grab[1] else ['"grab.wear" = { dist = "uniform", low = 0.1, high = 0.9 }']),
    ]
    return "\n".join(lines) + "\n"


def _grab(answers: _Answers, file: Path) -> tuple[list[str], float]:
    """Lines of the table of the grab, and its volume where that can vary."""

    def read(text: str) -> str:
        if text.lower() in GRABS:
            return text.lower()
        if not Path(text).is_file():
            raise ValueError(f"must be one of {', '.join(GRABS)}, or a file of a 3-D model; there is no file {text!r}")
        return text

    grab = answers.get("grab", read)
    if grab in ("four-rope", *(() if grab in GRABS else (grab,))):
        if answers.has("volume"):
            raise click.BadParameter(
                f"{grab} has a fixed size; leave it out, or choose another --grab", param_hint="--volume"
            )
        path = os.path.relpath(grab, file.parent)
        mesh = ['model = "mesh"', f"file = {json.dumps(path, ensure_ascii=False)} # see simgrab grab check"]
        return ["[grab]", *(['model = "four-rope"'] if grab in GRABS else mesh)], 0.0
    volume = answers.get("volume", _number(3, 20))
    return ["[grab]", f'model = "{grab}"', f"volume_m3 = {volume:g}"], volume


def _mood(moods: Sequence[tuple[str, str]], rate: float) -> list[str]:
    """Lines of light, weather and exposure: plain tables for one of each, drawn together for several."""
    made = [_tables(*mood) for mood in moods]
    exposure = min(0.033 if any(light == "night" for light, _ in moods) else 0.005, round(0.5 / rate, 4))
    shutter = ["", "[shutter]", f"exposure_s = {exposure}"]
    light, ev, grey, weather = made[0]
    if len(made) == 1:
        lines = [f'exposure = {{ model = "auto", exposure_ev = {ev} }}', f'night_mode = "{grey}"', *shutter]
        for name, table in (("light", light), ("weather", weather)):
            lines += ["", f"[{name}]", *(f"{key} = {value:g}" for key, value in table.items())] if table else []
        return lines
    values = [
        f'  {{ light = {_inline(light)}, "optics.exposure.exposure_ev" = {ev}, '
        f'"optics.night_mode" = "{grey}", weather = {_inline(weather)} }},'
        for light, ev, grey, weather in made
    ]
    return [
        'exposure = { model = "auto" }', *shutter, "", f'[vary."{JOINT}"]', 'dist = "one-of"',
        f"names = {json.dumps([', '.join(mood) for mood in moods])}", "values = [", *values, "]",
    ]  # fmt: skip


def _tables(light: str, weather: str) -> tuple[Mapping[str, float], float, str, Mapping[str, float]]:
    sun, sky, keys = WEATHERS[weather]
    night = {"sun": 0.0, "sky": 0.012, "floodlights": 0.06}
    return night if light == "night" else {"sun": sun, "sky": sky}, *LIGHTS[light], keys


def _inline(table: Mapping[str, float]) -> str:
    return f"{{ {', '.join(f'{key} = {value:g}' for key, value in table.items())} }}" if table else "{}"


def _tolerance(key: str, value: float, by: float, low: float = -math.inf, high: float = math.inf) -> list[str]:
    ends = (round(min(max(end, low), high), 3) for end in (value - by, value + by))
    return ['"{}" = {{ dist = "uniform", low = {:g}, high = {:g} }}'.format(key, *ends)]
