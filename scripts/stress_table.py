"""Print the key figures of a finished laboratory as a Markdown table: ``python -m scripts.stress_table FOLDER``.

FOLDER is what ``simgrab stress --all --out FOLDER`` made. Of each study: the error of α̂ at a true 10° in the worst
direction, mean over replications, at the worst value of its axes.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from simgrab.judge.stress import catalogue, laboratory
from simgrab.judge.stress.page import HALF_REFUSED, span, worst_at_ten
from simgrab.judge.stress.summary import Summary


def cell(summary: Summary, name: str) -> str:
    """Write one estimator's worst error, deg; nothing where it was not tried."""
    if name not in summary.study.estimators:
        return ""
    error, refused = worst_at_ten(summary, name)
    if refused > HALF_REFUSED:
        return "refused"
    return f"{error:.2f}" if np.isfinite(error) else ""


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True))
def main(folder: Path) -> None:
    """Print the table."""
    studies = [catalogue.load(name) for name in catalogue.names() if (folder / name / laboratory.TRIALS).exists()]
    everything = [laboratory.read(folder / study.name, study) for study in studies]
    found = [finding for finding in everything if finding.summary.study.kind == "estimators"]
    names = list(dict.fromkeys(name for f in found for name in f.summary.study.estimators))
    print(f"| study | {' | '.join(names)} |")
    print("|---|" + "---|" * len(names))
    for finding in found:
        study = finding.summary.study
        what = ", ".join(f"{s.axis} {span(s.values)}" for s in study.axes)
        print(f"| `{study.name}` ({what}) | {' | '.join(cell(finding.summary, name) for name in names)} |")
    limits = [verdict for finding in everything for verdict in finding.verdicts]
    print(f"\n{sum(v.passed for v in limits)} of {len(limits)} limits are met")


if __name__ == "__main__":
    main()
