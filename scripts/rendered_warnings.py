r"""Score early warnings on rendered videos, measured live with what a controller has reported by then.

    scripts/simgrab render alarm-cycles --size 960x540 --frames 16200 --set clip.clip_frames=2700 \
        --video runs/hard.mp4 --out runs/hard --set 'sensors.plc={model="controller"}'
    scripts/simgrab run runs/hard-000.mp4 --plc runs/hard/sensors/clip_000/plc --out runs/first
    scripts/python -m scripts.rendered_warnings runs/hard-*.mp4 --plc runs/hard/sensors --tilt runs/first/tilt.toml

A reading is used from its time stamp on.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from simgrab.instrument.pipeline import assemble
from simgrab.instrument.run.run import RunOptions, run
from simgrab.judge.evaluate import truths
from simgrab.judge.evaluate.evaluation import evaluate


@click.command()
@click.argument("videos", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--plc", type=click.Path(path_type=Path), help="Folder of the clips' sensors.  [default: none]")
@click.option("--tilt", required=True, help="tilt.toml of an earlier run.")
def main(videos: tuple[Path, ...], plc: Path | None, tilt: str) -> None:
    """Print a row for each video, and one for all."""
    found = list[dict[str, Any]]()
    for number, video in enumerate(videos):
        readings = None if plc is None else plc / f"clip_{number:03d}" / "plc"
        pipeline = assemble(tilt=tilt, live=True, plc=readings)
        measured = run(video, instrument=pipeline, options=RunOptions(live=True, video=False), report=print)
        values = evaluate(measured, truths.of(measured, video)).to_dict()
        found.append(values["warning"] | {"rmse_deg": values["angle"]["overall"]["rmse_deg"]})
        print(video, found[-1], flush=True)
    hours, events, missed, late, false = (
        sum(one[name] for one in found) for name in ("hours", "events", "missed", "late", "false")
    )
    lead = np.median([lead for one in found for lead in one["leads"]] or [np.nan])
    rmse = np.sqrt(np.mean([one["rmse_deg"] ** 2 for one in found]))
    print(
        f"{hours:.2f} h | {events} events | {missed} missed | {late} late | median lead {lead:.1f} s | {false} false "
        f"| RMSE of α {rmse:.2f}°"
    )


if __name__ == "__main__":
    main()
