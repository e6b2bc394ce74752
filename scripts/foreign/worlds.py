"""The worlds of the foreign exam."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from msgspec import structs
from numpy.random import Generator

from scripts.foreign import grabs
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import Iid, Mesh, Scenario
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
#: MuJoCo's and the path tracer's picture of each geometry: simgrab's own world, and the one with another grab.
PICTURES = {"own": ("mujoco", "cycles"), "grab": ("mujoco-grab", "grab")}


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

    def geometry(self, name: str, size: tuple[int, int], folder: Path) -> Scenario:
        """Draw the scenario of one of `PICTURES`' geometries; another grab's file goes into the folder."""
        scenario = self.scenario(size)
        return scenario if name == "own" else self.with_other_grab(scenario, folder)

    def scenario(self, size: tuple[int, int]) -> Scenario:
        """Draw its scenario: of an instant, without weather, and without motion blur."""
        base = FAMILIES[self.number % len(FAMILIES)][1]
        still = {"clip.clip_frames": 1, "shutter.exposure_s": 0.0, "shutter.rolling_s": 0.0}
        loaded = scenes.load(
            base, still | {"seed": self.seed, "frames": 1, "swing.absent": float(self.empty)}, size=size
        )
        return at_time(Recipe(loaded).variant(0).scenario, self.time, stream(self.seed, 0, "foreign.time"))

    def with_other_grab(self, scenario: Scenario, folder: Path) -> Scenario:
        """Replace the grab by one of its family that other code makes; its file goes into the folder."""
        rng = stream(self.seed, 0, "foreign.grab")
        keys = grabs.write(folder / "grab.glb", str(rng.choice(KINDS[self.family])), rng)
        assert isinstance(scenario.swing, Iid)
        swing = structs.replace(scenario.swing, clamp=True)
        return structs.replace(scenario, grab=Mesh.of(folder / "grab.glb", **keys), swing=swing)


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
