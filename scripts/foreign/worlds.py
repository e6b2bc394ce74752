"""The worlds of the foreign exam: what is rendered of each, and the conditions under which it is rendered."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from msgspec import structs
from numpy.random import Generator

from scripts.foreign import grabs
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import Clutter, Hold, Iid, Mesh, Plain, Scenario
from simgrab.world.extensions import Recipe

#: Base scene of each family of grabs. The default grab is in every second world.
DEFAULT_FAMILY = "four-rope"
FAMILIES = (
    (DEFAULT_FAMILY, "exam-calm"), ("clamshell or orange-peel", "exam-family-known"),
    (DEFAULT_FAMILY, "exam-calm"), ("scissors", "exam-family-scissors"),
)  # fmt: skip
KINDS = {DEFAULT_FAMILY: ("frame",), "clamshell or orange-peel": ("frame", "tines"), "scissors": ("levers",)}
TIMES = ("day", "dusk", "night")
SEEDS = {"tune": 9_310_000, "final": 9_710_000}  # neither half shares a world with the other, training or an exam
PLAIN_HEADS_M = 22.0, 35.0  # which `jib.head_height_m` allows


@dataclass(frozen=True)
class Replacement:
    """What of a world is replaced before simgrab labels it: its grab, its place, or both."""

    name: str
    grab: bool = False
    ground: bool = False


OWN, GRAB, GROUND, BOTH = (
    Replacement("own"), Replacement("grab", grab=True), Replacement("ground", ground=True),
    Replacement("both", grab=True, ground=True),
)  # fmt: skip


@dataclass(frozen=True)
class Condition:
    """One way to make pictures of the worlds.

    Attributes
    ----------
    replacement : Replacement
    render : tuple of str, or None
        What Blender replaces: "textures", "ground", "light". None renders with MuJoCo.
    camera : tuple of str
        What is replaced after the renderer: "sensor", "coder", "digits".
    """

    replacement: Replacement
    render: tuple[str, ...] | None = ()
    camera: tuple[str, ...] = ()

    @property
    def light(self) -> str | None:
        """Name of the path-traced light that the picture is made of; None where MuJoCo renders it."""
        return None if self.render is None else "-".join((self.replacement.name, *self.render))


CONDITIONS: Mapping[str, Condition] = {
    "mujoco": Condition(OWN, None),
    "cycles": Condition(OWN),
    "grab": Condition(GRAB),
    "textures": Condition(OWN, ("textures",)),
    "ground": Condition(GROUND, ("ground",)),
    "light": Condition(OWN, ("light",)),
    "sensor": Condition(OWN, camera=("sensor",)),
    "coder": Condition(OWN, camera=("coder",)),
    "digits": Condition(OWN, camera=("digits",)),
    "all": Condition(BOTH, ("textures", "ground", "light"), ("sensor", "coder", "digits")),
}


def beside(condition: Condition) -> str:
    """Name of MuJoCo's pictures of worlds with the same replacement."""
    return "mujoco" if condition.replacement == OWN else f"mujoco-{condition.replacement.name}"


def with_mujoco(names: Iterable[str]) -> dict[str, Replacement]:
    """List the pictures of some conditions and MuJoCo's beside, each with what of the worlds is replaced."""
    return {
        picture: condition.replacement
        for name in names
        for condition in [CONDITIONS[name]]
        for picture in (name, beside(condition))
    }


@dataclass(frozen=True)
class World:
    """One world of one half of the exam, of which there is one frame."""

    half: str
    number: int

    @property
    def seed(self) -> int:
        """Seed of its scenario."""
        return SEEDS[self.half] + self.number

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.half}-{self.number:04d}"

    @property
    def family(self) -> str:
        """Family of its grab."""
        return FAMILIES[self.number % len(FAMILIES)][0]

    @property
    def time(self) -> str:
        """Time of day."""
        return TIMES[self.number // len(FAMILIES) % len(TIMES)]

    @property
    def empty(self) -> bool:
        """Whether its grab is absent: in a quarter of the worlds, spread over families and times."""
        return (self.number // len(FAMILIES) + self.number) % len(FAMILIES) == len(FAMILIES) - 1

    def scenario(self, size: tuple[int, int]) -> Scenario:
        """Draw its scenario: of an instant, without weather, and without motion blur."""
        base = FAMILIES[self.number % len(FAMILIES)][1]
        still = {"clip.clip_frames": 1, "shutter.exposure_s": 0.0, "shutter.rolling_s": 0.0}
        loaded = scenes.load(
            base, still | {"seed": self.seed, "frames": 1, "swing.absent": float(self.empty)}, size=size
        )
        return at_time(Recipe(loaded).variant(0).scenario, self.time, stream(self.seed, 0, "foreign.time"))

    def replaced(self, scenario: Scenario, replacement: Replacement, folder: Path) -> Scenario:
        """Replace grab and place; the foreign grab's file goes into the folder."""
        if replacement.ground:
            scenario = levelled(scenario)
        if replacement.grab:
            scenario = structs.replace(scenario, grab=self.foreign_grab(folder))
            assert isinstance(scenario.swing, Iid)
            scenario = structs.replace(scenario, swing=structs.replace(scenario.swing, clamp=True))
        return scenario

    def foreign_grab(self, folder: Path) -> Mesh:
        """Make a grab of the world's family by other code; its file goes into the folder."""
        rng = stream(self.seed, 0, "foreign.grab")
        keys = grabs.write(folder / "grab.glb", str(rng.choice(KINDS[self.family])), rng)
        return Mesh.of(folder / "grab.glb", **keys)


def at_time(scenario: Scenario, time: str, rng: Generator) -> Scenario:
    """Give a scenario the light of a time of day; by night also floodlights, and perhaps the camera's night mode."""
    light, optics = scenario.light, scenario.optics
    if time == "dusk":
        light = structs.replace(
            light, sun=float(rng.uniform(0.25, 0.5)), sky=float(rng.uniform(0.25, 0.4)),
            sun_elevation_deg=float(rng.uniform(10, 18)),
        )  # fmt: skip
    if time == "night":
        light = structs.replace(light, sun=0.0, sky=0.012, floodlights=float(rng.uniform(0.045, 0.09)))
        optics = structs.replace(optics, night_mode="on" if rng.random() < 0.5 else "off")
    return structs.replace(scenario, light=light, optics=optics)


def levelled(scenario: Scenario) -> Scenario:
    """Put a level yard so far below the jib head that the longest rope of the place reaches no deeper."""
    depth = scenario.place.depth_m if isinstance(scenario.place, Hold) else 0.0
    low, high = PLAIN_HEADS_M
    head = min(max(scenario.jib.head_height_m + depth, low), high)
    jib = structs.replace(scenario.jib, head_height_m=head)
    return structs.replace(scenario, place=Plain(), clutter=Clutter(), jib=jib)
