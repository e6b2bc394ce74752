r"""Score early warnings on rendered videos, measured live with what a controller has reported by then.

    scripts/simgrab render alarm-cycles --size 960x540 --frames 16200 --set clip.clip_frames=2700 \
        --video runs/hard.mp4 --out runs/hard --set 'sensors.plc={model="controller"}'
    scripts/simgrab run runs/hard-000.mp4 --plc runs/hard/sensors/clip_000/plc --out runs/first
    scripts/python -m scripts.rendered_warnings runs/hard-*.mp4 --plc runs/hard/sensors --tilt runs/first/tilt.toml

Rows of the controller's file appear at their time stamps, as a logger writes them.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from simgrab.instrument.controller import Controller
from simgrab.instrument.controller_feed import ControllerFeed
from simgrab.instrument.pipeline import assemble
from simgrab.instrument.run.run import RunOptions, run
from simgrab.judge.evaluate import truths
from simgrab.judge.evaluate.evaluation import evaluate


class Replay(ControllerFeed):
    """A controller's file that grows as a video is measured."""

    def __init__(self, folder: Path, work: Path) -> None:
        header, *self.rows = (folder / "data.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        shutil.copy(folder / "data.toml", work)
        self.copy = work / "data.csv"
        self.copy.write_text(header, encoding="utf-8")
        self.rows.reverse()
        super().__init__(self.copy)

    def poll(self, now: float, _clock: float | None = None) -> Controller | None:
        """Write the rows that are due, and read them."""
        with self.copy.open("a", encoding="utf-8") as file:
            while self.rows and float(self.rows[-1].split(",")[0]) <= 1e9 * now:
                file.write(self.rows.pop())
        return super().poll(now, now)


@click.command()
@click.argument("videos", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--plc", type=click.Path(path_type=Path), help="Folder of the clips' sensors.  [default: none]")
@click.option("--tilt", required=True, help="tilt.toml of an earlier run.")
def main(videos: tuple[Path, ...], plc: Path | None, tilt: str) -> None:
    """Print a row for each video, and one for all."""
    found = list[dict[str, Any]]()
    for number, video in enumerate(videos):
        pipeline = assemble(tilt=tilt, live=True)
        with tempfile.TemporaryDirectory() as work:
            if plc is not None:
                folder = plc / f"clip_{number:03d}" / "plc"
                pipeline = replace(pipeline, feed=Replay(folder, Path(work)))
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
