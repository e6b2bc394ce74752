"""Grabs of random kinds, sizes and proportions."""

from __future__ import annotations

import msgspec
import numpy as np

from simgrab.model.scenario.grab import FourRope, Grab

_RATIO = (0.8, 1.3)
# Drive and ropes that go together, by kind.
_CLAMSHELL = (("ropes", 4), ("ropes", 2), ("ropes", 1), ("hydraulic", 1), ("hydraulic", 4))
_ORANGE_PEEL = (("ropes", 4), ("ropes", 2), ("hydraulic", 1), ("hydraulic", 4))


def any_of(kind: str, rng: np.random.Generator, volume_m3: tuple[float, float]) -> Grab:
    """Draw a grab of a kind; a kind of fixed shape needs no draw.

    Parameters
    ----------
    kind : str
        ``model`` of a scene's ``[grab]``.
    volume_m3 : tuple of 2 floats
        Least and most, m³.
    """
    if kind == "four-rope":
        return FourRope()
    if kind == "assembled":
        ropes = (4, 2, 1)[rng.integers(3)]
        keys = {"shape": rng.random(), "volume_m3": rng.uniform(*volume_m3), "ropes": ropes}
        return msgspec.convert({"model": kind, **keys}, Grab)

    def chance(share: float) -> bool:
        return bool(rng.random() < share)

    shape: dict[str, object] = {
        "volume_m3": rng.uniform(*volume_m3),
        **{name: rng.uniform(*_RATIO) for name in ("width", "length", "height")},
        "plate_work": rng.random(), "teeth": int(rng.choice([0, 0, 4, 7])),
        "ladder": chance(0.3), "guards": chance(0.4), "markings": chance(0.7),
    }  # fmt: skip
    match kind:
        case "clamshell":
            drive, ropes = _CLAMSHELL[rng.integers(len(_CLAMSHELL))]
            shape |= {
                "drive": drive, "ropes": ropes, "arms": 4 if chance(0.5) else 2,
                "top": "open" if chance(0.6) else "closed", "head": ("frame", "block", "round")[rng.integers(3)],
                "profile": "round" if chance(0.6) else "angular",
            }  # fmt: skip
        case "orange-peel":
            drive, ropes = _ORANGE_PEEL[rng.integers(len(_ORANGE_PEEL))]
            shape |= {
                "drive": drive, "ropes": ropes, "tines": (4, 5, 6, 8)[rng.integers(4)],
                "shells": ("closed", "half", "open")[rng.integers(3)],
            }  # fmt: skip
        case "scissors":
            shape |= {
                "ropes": 4 if chance(0.6) else 2, "top": "open" if chance(0.7) else "closed",
                "profile": "round" if chance(0.6) else "angular",
            }  # fmt: skip
    return msgspec.convert({"model": kind, **shape}, Grab)
