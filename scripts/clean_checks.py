"""How often a sound instrument fails a check by chance: ``python -m scripts.clean_checks SUITE [--instrument …]``.

Records a baseline, checks the suite under as many other seeds, and reports what failed and how close the rest came.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from simgrab.judge.check import baseline, cache, gate, suite
from simgrab.judge.check.verdicts import Verdict


def used(verdict: Verdict) -> float:
    """Share of what the baseline allows that a verdict uses; 0 where it was not compared."""
    if verdict.value is None or verdict.reference is None or not verdict.allowed:
        return 0.0
    over = (verdict.value - verdict.reference) / verdict.allowed
    return max(over if "≤" in verdict.limit else 0.0, -over if "≥" in verdict.limit else 0.0)


def main() -> int:
    """Check and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("suite")
    parser.add_argument("--instrument")
    parser.add_argument("--checks", type=int, default=20)
    parser.add_argument("--cache", type=Path, default=cache.default())
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    sys.path.insert(0, str(Path.cwd()))
    found = suite.load(arguments.suite)
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        options = gate.Options(arguments.instrument, Path(folder), cache=arguments.cache, workers=arguments.workers)
        print(*gate.record(found, options).notes)
        print(f"at most {baseline.FALSE_FAILURES:.1%} of sound checks may fail")
        for seed in range(found.seed + found.seeds, found.seed + found.seeds + arguments.checks):
            report = gate.check(
                found, gate.Options(options.instrument, options.baseline, seed, options.cache, options.workers)
            )
            failed += not report.passed
            closest = max(report.verdicts, key=used)
            state = "passed" if report.passed else "failed"
            print(
                f"seed {seed}: {state}; closest: {closest.scene} {closest.what}, {used(closest):.0%} of what is allowed"
            )
            for verdict in report.verdicts:
                if verdict.status == "failed":
                    print(f"  {verdict.scene} {verdict.what}: {verdict.message}")
    print(f"{failed} of {arguments.checks} sound checks failed")
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
