"""Make a dataset of many rows out of a rendered one, to measure how `simgrab browse` copes with it.

python -m scripts.make_large_dataset runs/quay-day runs/large [--rows 100000]

Rows, masks and pictures are those of the source, over and over: pictures are hard links. Angles, rope lengths and
visible fractions are drawn again, so that columns have as many values as rows. Labels do not fit the pictures then.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import click
import msgspec

import simgrab
from simgrab.labels.datasets import MANIFEST, Dataset
from simgrab.rng import stream
from simgrab.utilities.files import sha256
from simgrab.world.output.tables import Tables, into


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--rows", default=100_000, show_default=True)
def main(source: Path, out: Path, rows: int) -> None:
    """Make it."""
    dataset = simgrab.open(source)
    assert isinstance(dataset, Dataset)
    known = json.loads((source / MANIFEST).read_text(encoding="utf-8"))
    random = stream(1, 0, "large")

    frames = [(frame.truth, frame.coded_mask, frame.file) for frame in dataset]
    with Tables(into(out), known, dataset.scenario) as tables:
        for number in range(rows):
            row, mask, file = frames[number % len(frames)]
            assert file is not None
            name = f"images/{row.split}/{number:06d}{file.suffix}"
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            os.link(file, out / name)
            values = {
                "alpha_deg": abs(random.normal(0, 4)), "rope_length_m": random.uniform(12, 30),
                "visible_fraction": random.uniform(0.1, 1), "gamma_deg": random.uniform(0, 360),
            }  # fmt: skip
            made = msgspec.structs.replace(row, frame=number, file=name, **values)
            tables.add(made, None if mask is None else {"size": list(mask.size), "counts": mask.counts})
    known["files"] = {"labels.parquet": sha256(out / "labels.parquet")}
    (out / MANIFEST).write_text(json.dumps(known), encoding="utf-8")
    (out / "camera.toml").write_bytes((source / "camera.toml").read_bytes())


if __name__ == "__main__":
    main()
