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
from typing import TypeVar, get_args

import click
import tomli_w

from simgrab.cli._options import PATH, together
from simgrab.match import data_sheets
from simgrab.model.scenario import Cargo, Cycles, Dynamic, Grab, Iid, Jib, Quay, RigidMount, Scenario
from simgrab.text import encodable, printable

T = TypeVar("T")
GRABS = ("four-rope", "clamshell", "orange-peel", "scissors")
CARGOES = get_args(Cargo)
# Light of sun and sky by day, and keys of the weather.
WEATHERS: Mapping[str, tuple[float, float, Mapping[str, float]]] = {
    "clear": (1.0, 0.85, {}),
    "rain": (0.0, 0.6, {"rain_mm_h": 8, "wetness": 0.8, "lens_drops": 8}),
    "fog": (0.0, 0.8, {"wetness": 0.2}),
    "snow": (0.0, 0.75, {"snow_mm_h": 0.6, "snow_cover": 0.25}),
    "dust": (0.8, 0.85, {"dust_thickness": 1.8, "dust_radius_m": 2.5, "lens_dirt": 0.03}),
}
PAINTS = {
    "orange": [0.86, 0.52, 0.07], "yellow": [0.88, 0.72, 0.10], "red": [0.62, 0.12, 0.09], "blue": [0.10, 0.26, 0.55],
    "green": [0.12, 0.38, 0.20], "grey": [0.45, 0.46, 0.47], "black": [0.12, 0.12, 0.13], "white": [0.82, 0.82, 0.80],
}  # fmt: skip
FOGS_M = (50, 100, 200)  # visibilities, each in a third of the foggy worlds
NIGHT = {"sun": 0, "sky": 0.012, "floodlights": 0.06}
CYCLE_S, DIG_S = 75, 25
MOST_AROUND_M = 0.1  # how far each component of the offset may be off
NEAR_ROPE_M = 0.2  # a rope that is nearer to the lens hides much of the view
HEADS_M = 22, 60
SAME_SHAPE = 0.05  # least difference of the logarithms of width over height that counts
SPARE_M = 0.6  # 0.3 below the grab, and what a lean and a larger volume may take
# By option: the question, and what stands for an answer.
ASKED = {
    "camera": ("model of the camera (none: give sensor and lens)", ""),
    "size": ("size of the picture, px (with --camera: its own)", "1920x1080"),
    "fov": ("field of view on the data sheet, degrees across x up, such as 84x45 or 84 (none: not known)", ""),
    "sensor": ("format of the sensor, such as 1/2.8, or its name, such as IMX335", "1/2.8"),
    "lens": ("focal length of the lens, mm (with --camera: its longest)", "4"),
    "rate": ("pictures a second", "25"),
    "offset": (
        "camera from the middle of the rope exits: to the picture's top (outboard), to its left, up, m",
        "0,0.6,-0.3",
    ),
    "tilt": ("tilt of the camera from the vertical, or least and greatest, degrees", "3"),
    "height": ("height of the jib head above the quay, {} to {} m".format(*HEADS_M), "28"),
    "ropes": ("shortest and longest rope, to the grab's centre, m", "8..22"),
    "grab": (f"{', '.join(GRABS)}, or the file of a 3-D model", "four-rope"),
    "scale": ("metres a unit of the 3-D model's file (none: by its size)", ""),
    "up": ("axis of the 3-D model's file that points up: x, y, z, with a sign, or auto, by its format", "auto"),
    "volume": ("volume of the grab, m³, if it is not four-rope or a file", "6"),
    "cargo": (f"cargo of place and grab, one or more of {', '.join(CARGOES)}; random places have each", "coal"),
    "paint": (f"paint of the grab: {', '.join(PAINTS)}; in random places each", "orange"),
    "mount": ("levelled (hangs by gravity), rigid (pitches with the jib) or fixed", "levelled"),
    "light": ("day, night, or both", "day"),
    "weather": (f"one or more of {', '.join(WEATHERS)}", "clear"),
    "wind": ("mean wind, m/s: it carries rain, snow and dust, and pushes the grab in cycles", "0"),
    "display": ("rope lengths in the picture: none, or two-by-four or four-point-four digits", "none"),
    "place": ("quay, or random: quays, holds, water and yards, and all else that varies in training", "quay"),
    "motion": ("independent frames (to train on), or cycles of a working crane (video)", "independent"),
}


@click.command(name="new")
@click.argument("file", type=PATH)
@together(
    *(
        click.option(f"--{name}", help=f"{text[0].upper()}{text[1:]}.  [default: {usual or 'none'}]", metavar="TEXT")
        for name, (text, usual) in ASKED.items()
    )
)
@click.option("--fixed", is_flag=True, help="Let nothing vary but several lights or weathers, as check requires.")
@click.option("--yes", is_flag=True, help="Ask nothing: assume the usual where nothing is given.")
def command(file: Path, fixed: bool, yes: bool, **given: str | None) -> None:
    """Write a scene FILE from what you know of your camera, crane and grab.

    At a terminal it asks for what is not given. Elsewhere, and with --yes, it assumes the usual and prints what.
    """
    from simgrab.errors import ScenarioError
    from simgrab.io import files
    from simgrab.io.destination import check_new_folder, writing
    from simgrab.model import scenes

    def refuse(problem: str) -> ScenarioError:
        return ScenarioError("", problem)

    check_new_folder(file, refuse, "FILE")
    answers = _Answers(given, ask=not yes and sys.stdin.isatty())
    text = _scene(answers, file, fixed=fixed)
    with writing(file, refuse), files.drafted(file) as draft:
        draft.write_text(text, encoding="utf-8")
        try:
            scene = scenes.load(draft)
            _check_ropes(scene)
            if jaws := _jaws(scene):
                draft.write_text(text.replace("\nclamp = true", f"\n{jaws}\nclamp = true"), encoding="utf-8")
                scene = scenes.load(draft)
            size = _size_of_model(scene.grab) if 'model = "mesh"' in text else []
        except ScenarioError as problem:
            raise (_refusal("scale", problem.problem) if problem.key == "grab.scale" else problem) from None
    every = f"; [vary] draws again every {scene.clip.clip_frames} frames; a larger clip.clip_frames renders faster"
    for line in (
        *(f"warning: {line}" for line in answers.warnings),
        *(f"assumed: {line}" for line in answers.assumed),
        *(f"grab.file: {line}" for line in size),
        *([f"first: simgrab grab check {file} shows whether the 3-D model's size and axes are right"] if size else ()),
        f"next: simgrab render {file}{every if scene.vary else ''}",
    ):
        click.echo(printable(line))


def _check_ropes(scene: Scenario) -> None:
    """Refuse cycles that would lower the grab into the pile, or not lift it over the hopper."""
    from simgrab.model.distributions import Uniform

    if not (isinstance(scene.swing, Dynamic) and isinstance(scene.swing.work, Cycles)):
        return
    from simgrab.world.scenery.grabs import design_of
    from simgrab.world.scenery.places.hopper import TOP_M

    assert isinstance(scene.place, Quay)
    varied = scene.vary.get("jib.head_height_m")
    head = varied.low if isinstance(varied, Uniform) else scene.jib.head_height_m
    room = head - design_of(scene.grab).depth_m - SPARE_M
    work, dig, carry = scene.swing.work, room - scene.place.pile_height_m, room - TOP_M
    if work.dig_rope_m > dig or work.carry_rope_m > carry:
        raise _refusal(
            "ropes", f"{work.carry_rope_m:g} and {work.dig_rope_m:g} m are too long for cycles below a jib head of "
            f"{head:g} m: at most {carry:.1f} m carry this grab over the hopper, and {dig:.1f} m lower it on the pile"
        )  # fmt: skip


def _jaws(scene: Scenario) -> str:
    """Key of the jaws' opening for a grab that opens less far than those of the scene's base; else empty."""
    from simgrab.world.scenery.grabs import design_of

    if not isinstance(scene.swing, Iid):
        return ""
    most, stated = (
        math.floor(x) for x in (math.degrees(design_of(scene.grab).max_jaw), scene.swing.jaw_deg.support()[1])
    )
    if most >= stated:
        return ""
    values = f'{{ dist = "choice", values = [0, {most / 2:g}, {most}], weights = [3, 1, 1] }}' if most else "0"
    return f"jaw_deg = {values} # how far this grab opens"


def _size_of_model(grab: Grab) -> list[str]:
    from simgrab.judge.own_grab import remarks  # imports what renders

    return remarks(grab)


class _Answers:
    """What the user says, by option or when asked; `assumed` collects the rest, `warnings` what may be wrong."""

    def __init__(self, given: Mapping[str, str | None], *, ask: bool) -> None:
        self._given, self._ask = given, ask
        self._unread = [name for name, text in given.items() if text is not None]
        self.assumed: list[str] = []
        self.warnings: list[str] = []

    def __contains__(self, name: str) -> bool:
        return self._given[name] is not None

    @property
    def unread(self) -> str:
        """Options that were given and have no effect."""
        return ", ".join(f"--{name}" for name in self._unread)

    def get(self, name: str, read: Callable[[str], T], usual: str = "") -> T:
        """Read an answer by a function that raises ValueError for nonsense."""

        def value(text: str) -> T:
            try:
                return read("" if not default and text.strip().lower() == "none" else text.strip())
            except ValueError as problem:
                example = f", for instance {default}" if default else ""
                raise _refusal(name, f"{problem}{example}") from None

        self._unread = [one for one in self._unread if one != name]
        text, (question, default) = self._given[name], ASKED[name]
        if text is None and self._ask:
            usual = usual or default
            answer: T = click.prompt(f"{name}: {question}", usual, value_proc=value, show_default=bool(usual))
            return answer
        if text is None and (usual or default):
            self.assumed.append(f"--{name} {usual or default}: {question}")
        return value((usual or default) if text is None else text)


def _refusal(name: str, problem: str) -> click.BadParameter:
    return click.BadParameter(problem, param_hint=f"--{name}")


def _numbers(low: float, high: float, *counts: int) -> Callable[[str], tuple[float, ...]]:
    def read(text: str) -> tuple[float, ...]:
        try:
            plain = re.sub(r"\s*(mm|m³|m3|m/s|m|px|deg|fps)$", "", text)
            values = tuple(float(part) for part in re.split(r"\.\.|\bto\b|[,;x×°\s]+", plain) if part.strip())
        except ValueError:
            values = ()
        if len(values) not in (counts or (1,)) or not all(low <= value <= high for value in values):
            what = f"{' or '.join(map(str, counts))} numbers" if counts not in ((), (1,)) else "a number"
            raise ValueError(f"needs {what} from {low:g} to {high:g}, got {text!r}")
        return values

    return read


def _one_of(*valid: str, most: int = 1) -> Callable[[str], list[str]]:
    def read(text: str) -> list[str]:
        words = list(dict.fromkeys(re.findall(r"[^,\s]+", text.lower())))
        if not 1 <= len(words) <= most or not set(words) <= set(valid):
            raise ValueError(
                f"must be {'one' if most == 1 else 'one or more, with commas,'} of {', '.join(valid)}; got {text!r}"
            )
        return words

    return read


def _camera(text: str) -> str:
    wanted = _plain(text)
    found = [name for name in data_sheets.CAMERAS if wanted in _plain(name) or _plain(name.split()[1]) in wanted]
    if text and (len(found) != 1 or not wanted):
        cameras = ", ".join(data_sheets.CAMERAS)
        raise ValueError(f"{text!r} is none or several of {cameras}; or give --fov, or --sensor and --lens")
    return found[0] if text else ""


def _plain(name: str) -> str:
    return re.sub("[^a-z0-9]", "", name.lower())


def _fov(text: str) -> tuple[float, ...]:
    return _numbers(5, 130, 1, 2)(text) if text else ()


def _optics(answers: _Answers) -> tuple[str, int, int, float, tuple[float, float, float]]:
    """Return what the optics are, size of the picture, focal length in px, and the distortion k1, k2, k3."""
    camera = answers.get("camera", _camera)
    wide, high, lenses = data_sheets.CAMERAS.get(camera, (1920, 1080, {}))
    width, height = map(int, answers.get("size", _numbers(64, 4096, 2), f"{wide}x{high}"))
    given = fov = answers.get("fov", _fov) if "fov" in answers or not camera else ()
    name, f_px, listed = camera or "as given", 0.0, dict[str, float]()
    if given:
        wide, high = width, height
    elif camera:
        (mm,) = answers.get("lens", _numbers(0.5, 100), f"{max(lenses):g}")
        if mm not in lenses:
            raise _refusal("lens", f"{camera} has lenses of {', '.join(f'{one:g}' for one in lenses)} mm, got {mm:g}")
        name, fov = f"{camera}, {mm:g} mm", lenses[mm]
    else:
        wide, high = width, height
        name, f_px, mm = _of_sensor(answers, width, height)
        alike = ((one, of) for one, (*size, of) in data_sheets.CAMERAS.items() if size == [width, height])
        listed = {one: of[mm][0] for one, of in alike if mm in of}
    scale = max(width / wide, height / high)  # a picture of another shape is a part of the whole
    try:
        barrels = [data_sheets.barrel(wide, high, *fov)] if len(fov) == 2 else data_sheets.BARRELS
        c, f, distortion = data_sheets.first_fitting(
            width, height, barrels, lambda c: scale * (data_sheets.focal_px(wide, fov[0], c) if fov else f_px)
        )
    except ValueError as problem:
        raise _refusal("fov" if given else "lens", f"{problem}{'' if given else '; or give --fov'}") from None
    across = data_sheets.across_deg(width, f, c)
    name += f": {across:.0f} x {data_sheets.vertical_deg(width, height, across, c):.0f} degrees"
    if listed and not 0.97 * min(listed.values()) < across < 1.03 * max(listed.values()):
        others = ", ".join(f"{one} {degrees:.0f}" for one, degrees in listed.items())
        answers.warnings.append(
            f"cameras of this picture size and lens have other degrees across: {others}; see --camera"
        )
    if len(fov) < 2:
        up = ", from which degrees up follow; without those the focal length may be 5 % off" * len(fov)
        answers.assumed.append(f"--fov: {name}, with the usual distortion of surveillance lenses{up}")
    if fov and "sensor" in answers and "lens" in answers:
        sensor, other_px, _ = _of_sensor(answers, width, height)
        answers.warnings.append(f"the focal length is {f:.0f} px, as {name}; {sensor}, would have {other_px:.0f} px")
    return name, width, height, f, distortion


def _of_sensor(answers: _Answers, width: int, height: int) -> tuple[str, float, float]:
    """Name sensor and lens, and give their focal length in px of a picture of this size, and in mm."""
    sensor, by_format = answers.get("sensor", lambda text: data_sheets.sensor(text, width, height))
    size, pitch_um, wide, high = data_sheets.SENSORS[sensor]
    (mm,) = answers.get("lens", _numbers(0.5, 100))
    name, f_px = f'{size}" sensor as {sensor}', mm * 1000 / pitch_um * max(width / wide, height / high)
    if by_format and abs(math.log(wide / high * height / width)) > SAME_SHAPE:
        part_px, f_px = f_px, mm * 1000 / pitch_um * math.hypot(width, height) / math.hypot(wide, high)
        name = f'{size}" sensor with the diagonal of {sensor}'
        answers.warnings.append(
            f'no {size}" sensor is known here that has the shape of {width}x{height}: the focal length is {f_px:.0f} '
            f"px if the camera's has the diagonal of {sensor}, and {part_px:.0f} px if the picture is a part of "
            f"{sensor}'s; name the sensor, or give --fov"
        )
    return f"{name}, {mm:g} mm", f_px, mm


def _grab(answers: _Answers, file: Path, *, painted: bool) -> tuple[str, float]:
    """Keys of the table of the grab, with its paint or without, and its volume where that can vary."""
    from simgrab.judge.own_grab import likely_scale  # imports what renders
    from simgrab.model.scenario.grab import Up

    def read(text: str) -> str:
        if text.lower() in GRABS:
            return text.lower()
        if not Path(text).is_file():
            raise ValueError(f"must be one of {', '.join(GRABS)}, or a file of a 3-D model; there is no file {text!r}")
        if encodable(text) != text:
            raise ValueError(f"{text!r} is not UTF-8; give a name that a scene file can hold")
        return text

    grab = answers.get("grab", read)
    known = grab in GRABS
    for name in ("scale", "up"):
        if known and name in answers:
            raise _refusal(name, f"{grab} is no file of a 3-D model; leave it out")
    paint = ""
    if painted and (known or "paint" in answers):
        (colour,) = answers.get("paint", _one_of(*PAINTS))
        paint = f"\npaint_rgb = {PAINTS[colour]} # {colour}"
    if grab in GRABS[1:]:
        (volume,) = answers.get("volume", _numbers(3, 20))
        kind = ", 6 tines that close the bowl" if grab == "orange-peel" else ""
        keys = "ropes, tines, shells (open for scrap), drive" if kind else "ropes, drive"
        answers.assumed.append(f"grab: moved by 4 ropes{kind}; {keys} and other keys in [grab] set it (docs/grabs.md)")
        return f'model = "{grab}"\nvolume_m3 = {volume:g}{paint}', volume
    if "volume" in answers:
        raise _refusal(
            "volume", f"{grab} has a size of its own; leave it out, or give --grab {' or '.join(GRABS[1:])}, of 4 ropes"
        )
    if known:
        return f'model = "{grab}"{paint}', 0.0
    finish = f'\nfinish = "paint"{paint}' if paint else ""
    usual = f"{likely_scale(grab):g}"
    (scale,) = answers.get("scale", _numbers(1e-6, 1e6), usual)
    (up,) = answers.get("up", _one_of(*get_args(Up)))
    path = tomli_w.dumps({"file": os.path.relpath(grab, file.parent)}).strip()
    axes = f'scale = {scale:g} # m per unit of the file\nup = "{up}"{finish}'
    return f'model = "mesh"\n{path} # see: simgrab grab check\n{axes}', 0.0


def _table(keys: Mapping[str, float]) -> str:
    return f"{{ {', '.join(f'{key} = {value:g}' for key, value in keys.items())} }}" if keys else "{}"


def _moods(moods: Sequence[tuple[str, str]], rate: float, wind: float, *, varied: bool) -> tuple[str, str]:
    """Lines of light, exposure and weather: as keys, or as what varies where there are several, or the base varies."""
    made, names, weights = [], list[str](), list[float]()
    for (light, weather), fog_m in ((mood, fog) for mood in moods for fog in (FOGS_M if "fog" in mood else (0,))):
        (sun, sky, keys), night = WEATHERS[weather], light == "night"
        keys = {"visibility_m": fog_m, **keys} if fog_m else keys
        keys = {**keys, "wind_m_s": wind} if wind else keys
        names.append(f"{light}, {weather}{f' of {fog_m} m' if fog_m else ''}")
        weights.append(1 if fog_m else len(FOGS_M))
        made.append({
            "light": _table(NIGHT if night else {"sun": sun, "sky": sky}),
            "optics.exposure.exposure_ev": "-1.3" if night else "0.0",
            "optics.night_mode": '"on"' if night else '"off"',
            "shutter.exposure_s": f"{min(0.033 if night else 0.005, round(0.5 / rate, 4))}",
            "weather": _table(keys),
        })  # fmt: skip
    if len(made) == 1 and not varied:
        return "".join(f"{key} = {value}\n" for key, value in made[0].items()), ""
    rows = [", ".join(f'"{key}" = {value}' for key, value in one.items()) for one in made]
    values = "\n".join(f"  {{ {row} }}," for row in rows)
    share = f", weights = {weights}" if len(set(weights)) > 1 else ""
    key = f'"{"+".join(made[0])}"'
    return "", f'{key} = {{ dist = "one-of", names = {json.dumps(names)}{share}, values = [\n{values}\n] }}\n'


def _tolerances(facts: Mapping[str, tuple[float, float, float, float]]) -> str:
    """Lines of what varies: by key the fact, its tolerance, and what the key admits at least and at most."""
    lines = []
    for key, (fact, by, least, most) in facts.items():
        if not by:
            continue
        low, high = (round(min(max(end, least), most), 3) for end in (fact - by, fact + by))
        lines.append(f'"{key}" = {{ dist = "uniform", low = {low:g}, high = {high:g} }}')
    return "\n".join(lines)


def _around(answers: _Answers, offset: tuple[float, ...]) -> float:
    """How far each component of the camera's offset may be off, m, without the camera being in the jib head's steel.

    States a rope that is near the lens.
    """
    import numpy as np

    from simgrab.world.scenery.clearance import LEAST_ROOM_M, room_m
    from simgrab.world.scenery.meshes.jib import jib_steel
    from simgrab.world.scenery.meshes.ropes import Ropes

    ropes = Ropes.of(Jib(), 4)
    steel, (x, y, z) = jib_steel(ropes), offset
    room = room_m(np.array(offset), steel) - LEAST_ROOM_M
    apart = min(math.dist((x, y), place[:2]) for place in ropes.exits) - ropes.radius_m
    if room < 0:
        lower = (round(min(z, 0.0) - step / 20, 2) for step in range(1, 40))
        least = LEAST_ROOM_M + math.sqrt(3) * MOST_AROUND_M
        clear = next((z for z in lower if room_m(np.array([x, y, z]), steel) >= least), None)
        other = "0,0.6,-0.3" if clear is None or apart < NEAR_ROPE_M else f"{x:g},{y:g},{clear:g}"
        raise _refusal(
            "offset",
            f"{x:g},{y:g},{z:g} is in the jib head's steel or less than {LEAST_ROOM_M:g} m from it; {other} is not",
        )
    if apart < NEAR_ROPE_M and z < 0:
        answers.warnings.append(
            f"--offset: a rope hangs {max(apart, 0):.2f} m from the lens, and hides much of the view"
        )
    return min(MOST_AROUND_M, math.floor(100 * room / math.sqrt(3)) / 100)


def _scene(answers: _Answers, file: Path, *, fixed: bool) -> str:
    """Text of the scene file."""
    from simgrab.model import layouts

    assume, warn = answers.assumed.append, answers.warnings.append
    optics, width, height, f_px, (k1, k2, k3) = _optics(answers)
    (rate,) = answers.get("rate", _numbers(0.1, 120))
    x, y, z = offset = answers.get("offset", _numbers(-3, 3, 3))
    around = _around(answers, offset)
    tilts = answers.get("tilt", _numbers(0, 28, *((1,) if fixed else (1, 2))))
    tilt, lean = sum(tilts) / len(tilts), (tilts[-1] - tilts[0]) / 2 if len(tilts) > 1 else 2
    if lean <= 0:
        raise _refusal("tilt", f"the second must be above the first, got {tilts[0]:g} and {tilts[1]:g}")
    (head,) = answers.get("height", _numbers(*HEADS_M))
    short, long = answers.get("ropes", _numbers(6, 45, 2))
    if short >= long:
        raise _refusal("ropes", f"the second must be above the first, got {short:g} and {long:g}")
    lights = answers.get("light", lambda text: _one_of("day", "night", most=2)(text.replace("both", "day,night")))
    weathers = answers.get("weather", _one_of(*WEATHERS, most=5))
    (wind,) = answers.get("wind", _numbers(0, 40))
    moods = list(itertools.product(lights, weathers))
    cycles = answers.get("motion", _one_of("independent", "cycles")) == ["cycles"]
    mount = answers.get("mount", _one_of("levelled", "rigid", "fixed"))[0] if cycles or "mount" in answers else ""
    pitch = ""
    if mount == "rigid" and cycles:
        per_m = RigidMount().pitch_deg_per_m
        pitch = f", pitch_deg_per_m = {per_m:g}"
        assume(f"rigid: pitches by {per_m:g} degrees for each metre of luffing; pitch_deg_per_m sets it")
    if mount and not cycles:
        warn("--mount: only stated in camera.toml, since nothing moves the camera in independent frames")
    anywhere = (not cycles or "place" in answers) and answers.get("place", _one_of("quay", "random")) == ["random"]
    if anywhere and (cycles or fixed):
        raise _refusal("place", f"random places are of independent frames{', which vary: leave out --fixed' * fixed}")
    grab, volume = _grab(answers, file, painted=not anywhere or "paint" in answers)
    if anywhere and "cargo" in answers:
        raise _refusal("cargo", "random places have cargo of each kind; leave it out, or give --place quay")
    cargoes = [""] if anywhere else answers.get("cargo", _one_of(*CARGOES, most=1 if fixed else len(CARGOES)))
    cargo = cargoes[0]
    grab += f'\ncargo = "{cargo}"' * bool(cargo)
    swing = f'rope_length_m = {{ dist = "uniform", low = {short:g}, high = {long:g} }}\nclamp = true'
    swing += "\nalpha = { sigma_deg = 2.0 } # size of the swing; far ones must not reach hopper or hatch"
    if cycles:
        swing = f'model = "dynamic"\nwork = {{ model = "cycles", dig_rope_m = {long:g}, carry_rope_m = {short:g} }}'
        swing += f"\nwind = {{ mean_m_s = {wind:g} }}"
        swing += f"\nsettle_s = {DIG_S} # simulated before the first frame; by then the grab may swing"
    else:
        calm = ", whatever the wind, which carries rain, snow and dust alone" if wind else ""
        assume(f"swing: standard deviation of 2 degrees{calm}; sigma_deg in [swing] sets it")
        assume("yaw: standard deviation of 12 degrees, as ropes turn the grab back; yaw_deg sets it")
        swing += '\nyaw_deg = { dist = "normal", mean = 0, sd = 12, low = -60, high = 60 } # about the ropes'
    swing += "\nload = 0 # it holds none" * ('model = "mesh"' in grab and not cycles)
    if anywhere:
        if long > head - 3:
            warn(f"--ropes: ropes are shortened where the grab would reach the ground, up to {long:g} m")
        assume(
            "place, parked grabs, jib head, lens, sensor and the grab's details vary as in training, and one frame in "
            "20 shows no grab; keys that this file states do not"
        )
    elif long > head - 3 and not cycles:
        assume(f"place: an empty hold, because a grab on {long:g} m of rope reaches below the quay")
        swing += f'\n\n[place]\nmodel = "hold"\ncargo = "{cargo}"\ndepth_m = 18.0\nfill = 0.0'
    else:
        assume("place: a quay; model in [place] sets it")
        swing += f'\n\n[place]\ncargo = "{cargo}"'
    if not cycles and not anywhere:
        assume("every frame shows the grab; absent in [swing] leaves it out")
    if not anywhere:
        assume("no noise of the sensor; optics.sensor sets it")
    if fixed:
        assume("the tilt leans outboard, and roll is 0; tilt_azimuth_deg and roll_deg in [camera] set it")
    else:
        assume(
            f"within: {'' if len(tilts) > 1 else '2 degrees of '}the tilt, in any direction, 3 degrees of roll, "
            f"{around:g} m of the offset, 1 % of the focal length, 0.5 m of the height"
            f"{', 10 % of the volume' if volume else ''}; [vary] sets them"
        )
    for weather in weathers:
        if keys := WEATHERS[weather][2]:
            assume(f"{weather}: {', '.join(f'{key} {value:g}' for key, value in keys.items())}")
    if "night" in lights:
        assume("night: lamps of the quay, and a grey picture; light, night_mode and exposure_ev set it")
    (display,) = answers.get("display", _one_of("none", *layouts.names()))
    if answers.unread:
        warn(f"{answers.unread}: no effect beside {'--fov' if 'fov' in answers else '--camera'}")
    inf = math.inf
    facts = {
        "camera.focal.focal_length_px": (f_px, 0.01 * f_px, 100, inf),
        "camera.beta_deg": (tilt, lean, 0, 30),
        "camera.tilt_azimuth_deg": (0, 180, -180, 180),
        "camera.roll_deg": (0, 3, -inf, inf),
        "camera.offset_x_m": (x, around, -3, 3),
        "camera.offset_y_m": (y, around, -3, 3),
        "camera.offset_z_m": (z, around, -3, 1),
        "jib.head_height_m": (head, 0.5, *HEADS_M),
    }
    if anywhere and "paint" in answers:  # which shows
        facts |= {"grab.wear": (0.25, 0.25, 0, 1), "grab.residue": (0.2, 0.2, 0, 1)}
    if volume:
        facts["grab.volume_m3"] = (volume, 0.1 * volume, 3, 20)
    if "day" in lights:
        facts |= {"light.sun_elevation_deg": (45, 20, 10, 90), "light.sun_azimuth_deg": (0, 180, -360, 360)}
    plain, varied = _moods(moods, rate, wind, varied=anywhere)
    if anywhere:
        varied += f'"weather.wind_m_s" = {{ dist = "constant", value = {wind:g} }}\n'
    if len(cargoes) > 1:
        each = ", ".join(f'{{ "place.cargo" = "{one}", "grab.cargo" = "{one}" }}' for one in cargoes)
        varied += f'"place.cargo+grab.cargo" = {{ dist = "one-of", values = [{each}] }}\n'
    varied += "" if fixed else _tolerances(facts)
    vary = f"\n[vary]{'' if fixed else ' # tolerances of these facts'}\n{varied.rstrip()}\n" if varied else ""
    again = f" # after which [vary] draws again{'' if cycles else '; more of them render faster, and vary less'}"
    clip = round(CYCLE_S * rate) if cycles else 8 if anywhere else 2
    name = printable(file.name)
    return f"""# Written by simgrab new. simgrab scenes show {name} prints every other key with its value.
base = "{"training" if anywhere else "quay-day"}"
name = "{re.sub("[^a-z0-9_-]+", "-", file.stem.lower()).strip("-_")[:64] or "port"}"
description = "Ropes of {short:g} to {long:g} m, by {" and ".join(lights)}, {", ".join(weathers)}."
frames = {clip * (1 if fixed else 2) if cycles else 800 if anywhere else 200}
{plain}display.layout = "{display}"
optics.exposure.model = "auto"

[camera] # {optics}
width_px = {width}
height_px = {height}
focal = {{ model = "pixels", focal_length_px = {f_px:.1f} }} # in the middle of the picture
distortion = {{ k1 = {k1}, k2 = {k2}, k3 = {k3} }} # spans that field of view; a calibration replaces it
beta_deg = {tilt:g} # tilt from the vertical
offset_x_m = {x:g} # from the rope exit: outboard
offset_y_m = {y:g} # sideways
offset_z_m = {z:g} # up
{f'mount = {{ model = "{mount}"{pitch} }}{chr(10)}' if mount else ""}
[jib]
head_height_m = {head:g}

[swing]
{swing}

[grab]
{grab}

[clip]
frame_rate_hz = {rate:g}
clip_frames = {clip}{again if varied else ""}
{vary}"""
