"""The pipeline under test: found by name, held to the contract, and its failures told in one line."""

from __future__ import annotations

import importlib
import math
import re
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from simgrab.calibration import Calibration
from simgrab.errors import InstrumentError, SimgrabError
from simgrab.instrument.contract import Frame, Instrument, Measurement
from simgrab.instrument.pipeline import Pipeline, bundled

BUNDLED = "bundled"
PACKAGE = Path(__file__).parents[1]
_NUMBERS = re.compile(r"([0-9?]\.?){3}[0-9?] ([0-9?]\.?){3}[0-9?]")


def open_instrument(name: str) -> Instrument:
    """Make an instrument by the name of its factory.

    Parameters
    ----------
    name : str
        ``bundled``, or ``package.module:factory``: a callable without arguments that gives an
        `simgrab.instrument.contract.Instrument`.

    Raises
    ------
    InstrumentError
        In one line what failed, and where.
    """
    module, colon, factory = name.partition(":")
    if name != BUNDLED and not (module and colon and factory):
        raise InstrumentError(f"instrument {name!r}: name {BUNDLED!r}, or a factory as package.module:factory")
    with told(f"instrument {name}: cannot be imported"):
        make = bundled if name == BUNDLED else getattr(importlib.import_module(module), factory)
    with told(f"instrument {name}: cannot be made"):
        made = make()
    return held(made, name)


def held(instrument: Any, what: str = "instrument") -> Instrument:
    """Hold an instrument to the contract, so that whatever goes wrong in it is an `InstrumentError`."""
    if isinstance(instrument, Pipeline | Held):
        return instrument
    with told(f"{what}: has no name"):
        name = instrument.name
    if not isinstance(name, str) or not name:
        raise InstrumentError(f"{what}: its name must be a text, got {name!r}")
    if not callable(instrument):
        raise InstrumentError(f"{what}: {name} cannot be called with frames and a calibration")
    return Held(name, instrument)


@dataclass(frozen=True)
class Held:
    """Somebody's instrument, whose measurements are looked through before they are believed."""

    name: str
    instrument: Instrument

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:
        """Measure a record; numbers of NumPy's are taken for plain ones."""
        passing = iter(frames)
        with told(self.name):
            given = tuple(self.instrument(passing, calibration))
        for _ in passing:  # so that those it did not ask for are counted too
            pass
        return tuple(self._plain(i, one) for i, one in enumerate(given))

    def _plain(self, i: int, given: object) -> Measurement:
        if not isinstance(given, Measurement):
            raise InstrumentError(f"{self.name}: frame {i}: expected a Measurement, got {type(given).__name__}")
        try:
            plain = msgspec.convert({k: _number(v) for k, v in msgspec.structs.asdict(given).items()}, Measurement)
        except msgspec.ValidationError as problem:
            text, _, key = str(problem).replace("`", "").partition(" - at $.")
            raise InstrumentError(f"{self.name}: frame {i}: {key or 'measurement'}: {text}") from None
        if wrong := _problem(plain):
            raise InstrumentError(f"{self.name}: frame {i}: {wrong}")
        return plain


def _problem(m: Measurement) -> str:
    """Say what is wrong with a measurement that its types do not tell; empty where nothing is."""
    for name, value in msgspec.structs.asdict(m).items():
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(x) for x in numbers if isinstance(x, float)):
            return f"{name}: {value} is not finite; leave out what is not known"
    if m.alpha is not None and m.alpha > math.pi / 2:
        return f"alpha: {m.alpha:g} rad is beyond the horizontal"
    if m.alpha_low is not None and m.alpha_high is not None and m.alpha_low > m.alpha_high:
        return f"alpha_low: {m.alpha_low:g} rad is above alpha_high, {m.alpha_high:g}"
    if m.box is not None and not (m.box[0] < m.box[2] and m.box[1] < m.box[3]):
        return f"box: x0 < x1 and y0 < y1 are due, got {m.box}"
    if m.rope_text is not None and not _NUMBERS.fullmatch(m.rope_text):
        return f"rope_text: four digits, a blank and four digits are due, as in '0615 09??', got {m.rope_text!r}"
    return ""


def _number(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return tuple(map(_number, value)) if isinstance(value, tuple | list) else value


@contextmanager
def told(what: str) -> Iterator[None]:
    """Turn whatever is raised into one line that says what failed, why, and where in somebody's code.

    Raises
    ------
    InstrumentError
    """
    try:
        yield
    except InstrumentError:
        raise
    except SimgrabError as problem:
        raise InstrumentError(f"{what}: {problem}") from problem
    except (Exception, SystemExit) as problem:
        lines = str(problem).strip().splitlines()
        cause = f"{type(problem).__name__}: {lines[0]}" if lines else type(problem).__name__
        raise InstrumentError(f"{what}: {cause}{_where(problem)}") from problem


def _where(problem: BaseException) -> str:
    """Innermost line outside of simgrab and of Python's own importing."""
    steps = [step for step in traceback.extract_tb(problem.__traceback__) if not _inside(step.filename)]
    return f" ({steps[-1].filename}, line {steps[-1].lineno})" if steps else ""


def _inside(file: str) -> bool:
    return file.startswith("<frozen") or PACKAGE in Path(file).parents or file.endswith("importlib/__init__.py")
