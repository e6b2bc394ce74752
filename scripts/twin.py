"""Print the paper's video beside its twin, the scene `qingdao-twin`, for the scene's seed and ten others.

    uv run scripts/twin.py [SCENE] [--seeds N]

How the twin was tuned. The paper says what its record looks like (sections 3 and 4.5), not what the crane did. Left
free, within what such cranes do, were: the tilt and where it points, the camera's offset, how rough the operator is
and how much cycles vary, slewing, luffing and hoisting (arc, reach, speeds), depths, digging time and pauses, how hard
the slewing is braked now and then, a light wind, and the damping. A random search and then least squares minimised the
misfit of the medians over the seeds 101 to 110, each in units of the accepted one (10 %, tails and maximum 25 %), and
the values were rounded. The last step, the tilt and the time of the hard braking, was set by eye on the seeds 1 to 10,
so that none of them is refused by the paper's iteration; `--set seed=10` shows ten that nothing was tuned on.

What the tuning says about the record. The tail (0.8 % of frames beyond 300 px) needs a rare hard event where the rope
is short: here every fifth cycle brakes its slewing within 2.25 s and swings by about 10 degrees until it digs. A harder
one lifts the kurtosis of the ray angles above 3, and the paper's iteration, started at 0, then has no solution. With a
levelled camera the tilt follows what the accelerating jib feels, which the paper's constant β does not know.

The two weather records give only β̂ and σ̂; tilt, luffing, operator and braking were set by hand on the seeds 1 to 10. In
heavy snow the camera is bolted to the jib, which luffs in by 1.8 m to dump and pitches by 2 degrees a metre.
"""

from __future__ import annotations

import math
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import stats

from simgrab import scenes
from simgrab.geometry import to_camera
from simgrab.instrument.estimate import PaperIteration
from simgrab.scenario import Scenario
from simgrab.world.output.tables import calibration_of
from simgrab.world.trajectory.trajectory import Trajectory

# Name, published value, accepted deviation (share of it), format. None where the paper gives words.
PUBLISHED: list[tuple[str, float | None, float, str]] = [
    ("m, 5 % quantile (px)", 28.0, 0.10, ".1f"),
    ("m, 95 % quantile (px)", 182.0, 0.10, ".1f"),
    ("m above 300 px (%)", 0.8, 0.25, ".2f"),
    ("largest α̂ (deg)", 10.010, 0.25, ".2f"),
    ("β̂ (deg)", 2.530, 0.10, ".3f"),
    ("σ̂ (deg)", 2.664, 0.10, ".3f"),
    ("α̂ at most 5 deg (%)", 95.0, 0.10, ".1f"),
    ("iterations", 8.0, math.inf, ".0f"),
    ("θ: mean sine ('fairly symmetric')", None, 0.0, ".3f"),
    ("rope within 0.5 m of its minimum (%) ('a spike')", None, 0.0, ".1f"),
    ("rope elsewhere: distance from uniform ('near uniform')", None, 0.0, ".3f"),
    ("true √E[α²] (deg), which the paper cannot know", None, 0.0, ".3f"),
    ("largest true α (deg)", None, 0.0, ".2f"),
    ("mean true β (deg)", None, 0.0, ".3f"),
]


# What the paper gives of its other records: two numbers.
RECORDS: dict[str, dict[str, float]] = {
    "qingdao-twin": {name: value for name, value, _, _ in PUBLISHED if value is not None},
    "qingdao-night-snow": {"β̂ (deg)": 3.005, "σ̂ (deg)": 3.020, "iterations": 7},
    "qingdao-heavy-snow": {"β̂ (deg)": 4.221, "σ̂ (deg)": 3.177, "iterations": 9},
}


def measure(scenario: Scenario) -> list[float]:
    """Statistics of one record, in the order of `PUBLISHED`; the estimate takes the true grab centres."""
    story, k = Trajectory(scenario), scenario.camera.intrinsics
    centres, tilts, grabs = [], [], []
    for frame in range(scenario.frames):
        moment = story.at(frame)
        centres.append(moment.grab.jib_from_grab[:3, 3])
        tilts.append(moment.tilt)
        grabs.append(moment.grab)
    rotations = np.array([tilt.jib_from_camera for tilt in tilts])
    pixels = k.project(to_camera(np.array(centres), rotations, scenario.camera.offset_m))
    found = PaperIteration().estimate(pixels, calibration_of(scenario))
    rope, alpha = np.array([g.rope_length for g in grabs]), np.array([g.alpha for g in grabs])
    m, angle = k.polar(k.undistort(pixels))
    low = rope.min()
    free = rope[rope > low + 0.5]
    uniform = stats.kstest(free, stats.uniform(free.min(), np.ptp(free)).cdf).statistic
    estimated = [math.nan] * 5
    theta = math.nan
    if found.ok:
        assert found.alpha is not None
        assert found.beta is not None
        assert found.sigma is not None
        assert found.tilt_azimuth is not None
        degrees = np.degrees(found.alpha)
        estimated = [
            float(degrees.max()), math.degrees(found.beta), math.degrees(found.sigma),
            100 * float((degrees <= 5).mean()), float(found.diagnostics["iterations"]),
        ]  # fmt: skip
        theta = float(np.mean(np.sin(angle - (np.pi / 2 - found.tilt_azimuth))))
    return [
        float(np.quantile(m, 0.05)), float(np.quantile(m, 0.95)), 100 * float((m > 300).mean()), *estimated, theta,
        100 * float((rope <= low + 0.5).mean()), float(uniform), math.degrees(math.sqrt(np.mean(alpha**2))),
        math.degrees(alpha.max()), math.degrees(np.mean([tilt.beta for tilt in tilts])),
    ]  # fmt: skip


@click.command()
@click.argument("scene", type=click.Choice(list(RECORDS)), default="qingdao-twin")
@click.option("--seeds", default=10, show_default=True, help="Other seeds.")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="Change the scene.")
def main(scene: str, seeds: int, changes: tuple[str, ...]) -> None:
    """Print the table; exit with 1 where a median is out of its bound."""
    changed: dict[str, Any] = scenes.parse_changes(changes)
    own = scenes.load(scene, changed)
    rows = [measure(own)]
    rows += [measure(scenes.load(scene, changed | {"seed": own.seed + 1 + k})) for k in range(seeds)]
    medians = np.nanmedian(np.array(rows[1:]), axis=0)
    table = Table(title=f"The paper's record and {scene}, {own.frames} frames", title_justify="left")
    for column in (
        "",
        "published",
        f"seed {own.seed}",
        "median of ten" if seeds == 10 else f"median of {seeds}",
        "all",
    ):
        table.add_column(column, justify="right" if column else "left")
    missed = 0
    for i, (name, _, bound, form) in enumerate(PUBLISHED):
        value = RECORDS[scene].get(name)
        off = value is not None and abs(medians[i] / value - 1) > bound
        missed += off
        table.add_row(
            name,
            "" if value is None else f"{value:{form}}",
            f"{rows[0][i]:{form}}",
            f"{medians[i]:{form}}" + (" !" if off else ""),
            " ".join(f"{row[i]:{form}}" for row in rows[1:]),
        )
    Console(width=170).print(table)
    raise SystemExit(1 if missed else 0)


if __name__ == "__main__":
    main()
