"""The instrument under test: found by name, checked against the contract, with failures reported in one line."""

from __future__ import annotations

import threading
import traceback
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np

from simgrab.errors import InstrumentError, RecordError, SimgrabError
from simgrab.instrument.contract import Frame, Instrument, Measurement, Status, TakesSensors, flaw
from simgrab.instrument.estimate import ESTIMATORS
from simgrab.instrument.pipeline import Pipeline, assemble
from simgrab.io.strict import in_words
from simgrab.model.calibration import Calibration
from simgrab.runtime import modules

BUNDLED = "bundled"
PACKAGE = Path(__file__).parents[2]
_MOST_KEPT = 8


def open_instrument(name: str) -> Instrument:
    """Make an instrument by the name of its factory.

    Parameters
    ----------
    name : str
        ``bundled``; the name of an estimator, with which simgrab's own pipeline measures; or
        ``package.module:factory``: a callable without arguments that gives an `simgrab.instrument.contract.Instrument`.

    Raises
    ------
    InstrumentError
        With one line that states what failed, and where.
    """
    module, colon, factory = name.partition(":")
    own = name == BUNDLED or name in ESTIMATORS
    if not own and not (module and colon and factory):
        raise InstrumentError(
            f"instrument {name!r}: name {BUNDLED!r}, an estimator, or a factory as package.module:factory"
        )
    with one_line(f"instrument {name}: cannot be imported"):
        make = partial(assemble, estimator=None if name == BUNDLED else name) if own else modules.find(module, factory)
    with one_line(f"instrument {name}: cannot be made"):
        made = make()
    return checked(made, name)


def checked(instrument: Any, what: str = "instrument") -> Pipeline | CheckedInstrument:
    """Check an instrument against the contract.

    Any failure in it becomes an `InstrumentError`, except a `RecordError`, which the contract allows.
    """
    if isinstance(instrument, Pipeline | CheckedInstrument):
        return instrument
    with one_line(f"{what}: has no name"):
        name = instrument.name
    if not isinstance(name, str) or not name:
        raise InstrumentError(f"{what}: its name must be a text, got {name!r}")
    if not callable(instrument):
        raise InstrumentError(f"{what}: {name} cannot be called with frames and a calibration")
    return CheckedInstrument(name, instrument)


@dataclass(frozen=True)
class CheckedInstrument:
    """A user's instrument, whose measurements are checked before they are used."""

    name: str
    instrument: Instrument

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:
        """Measure a record; NumPy's numbers are converted to plain ones."""
        passing = _Passing(self.name, frames)
        given: list[object] = []
        with one_line(self.name, passing=RecordError, after=lambda: passing.latest(len(given))):
            found: object = self.instrument(passing, calibration)
            if not isinstance(found, Iterable):
                kind = type(found).__name__
                raise InstrumentError(f"{self.name}: must return a list, one Measurement for each frame; got {kind}")
            for one in found:
                if not passing.reach(len(given) + 1):
                    if not given:  # nor is there a frame, which is reported elsewhere
                        break
                    raise InstrumentError(
                        f"{self.name}: more than {len(given)} measurements of {len(given)} frames; "
                        "one for each frame is required"
                    )
                given.append(one)
        passing.reach(None)  # so that those it did not ask for are counted too
        return tuple(self._plain(i, one) for i, one in enumerate(given))

    def check_inputs(self, sensors: Collection[str], *, display: bool) -> None:  # noqa: ARG002
        """Refuse sensors if the instrument does not take any; see `Pipeline.check_inputs`."""
        if sensors:
            self._taking_sensors()

    def with_sensors(self, sensors: Mapping[str, Path]) -> Instrument:
        """Return the instrument for a record with sensors; see `TakesSensors`."""
        instrument = self._taking_sensors()
        with one_line(f"{self.name}: with_sensors", passing=RecordError):
            return checked(instrument.with_sensors(sensors), f"{self.name}: with_sensors")

    def _taking_sensors(self) -> TakesSensors:
        if not isinstance(self.instrument, TakesSensors):
            raise InstrumentError(f"{self.name} takes no sensors: it has no method with_sensors")
        return self.instrument

    def _plain(self, i: int, given: object) -> Measurement:
        if not isinstance(given, Measurement):
            raise InstrumentError(f"{self.name}: frame {i}: expected a Measurement, got {type(given).__name__}")
        try:
            plain = msgspec.convert({k: _number(v) for k, v in msgspec.structs.asdict(given).items()}, Measurement)
        except msgspec.ValidationError as problem:
            text, _, key = str(problem).partition(" - at `$.")
            key = key.rstrip("`") or "measurement"
            known = f"; there are: {', '.join(get_args(Status))}" if key == "status" else ""
            raise InstrumentError(f"{self.name}: frame {i}: {key}: {in_words(text)}{known}") from None
        if wrong := flaw(plain):
            raise InstrumentError(f"{self.name}: frame {i}: {wrong}")
        return plain


class _Passing:
    """Frames on their way to an instrument, counted.

    An instrument that yields measurements without requesting frames, perhaps endlessly, is stopped at the end of the
    frames, because they are counted in its place. It may still request the few latest ones.
    """

    def __init__(self, name: str, frames: Iterable[Frame]) -> None:
        self._name, self._frames = name, iter(frames)
        self._lock = threading.Lock()  # it may ask from another thread
        self._kept = deque[Frame](maxlen=_MOST_KEPT)
        self._taken = 0  # by it, or too long ago to be kept
        self._count = 0
        self._ended = False  # whether it asked for one more than there are

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        with self._lock:
            if self._count - self._taken > len(self._kept):
                raise InstrumentError(f"{self._name}: requested frame {self._taken} after measuring later frames")
            try:
                frame = self._kept.popleft() if self._kept else self._next()
            except StopIteration:
                self._ended = True
                raise
            self._taken += 1
            return frame

    def latest(self, given: int) -> str:
        """Name the frame that was taken last, and the one that was measured last, of those ``given`` so far."""
        taken = f"the last frame it took is {self._taken - 1}" if self._taken else "it took no frame"
        taken = f"it had taken all {self._taken} frames" if self._ended else taken
        return f"; {taken}{f', and measured up to frame {given - 1}' if given else ''}"

    def reach(self, count: int | None) -> bool:
        """Advance to this number of frames; False if there are no more. None advances to the end."""
        with self._lock:
            while count is None or self._count < count:
                try:
                    self._kept.append(self._next())
                except StopIteration:
                    return False
            return True

    def _next(self) -> Frame:
        frame = next(self._frames)
        self._count += 1
        return frame


def _number(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return tuple(map(_number, value)) if isinstance(value, tuple | list) else value


@contextmanager
def one_line(
    what: str, *, passing: type[SimgrabError] = InstrumentError, after: Callable[[], str] = str
) -> Iterator[None]:
    """Turn any exception into one line: what failed, why, where in the user's code, and what notes and ``after`` add.

    Errors of the class ``passing`` are raised as they are.

    Raises `InstrumentError`.
    """
    try:
        yield
    except (InstrumentError, passing):
        raise
    except SimgrabError as problem:
        raise InstrumentError(f"{what}: {problem}{_notes(problem)}") from problem
    except (Exception, SystemExit) as problem:
        lines = str(problem).strip().splitlines()
        cause = f"{type(problem).__name__}: {lines[0]}" if lines else type(problem).__name__
        raise InstrumentError(f"{what}: {cause}{_where(problem)}{_notes(problem)}{after()}") from problem


def _notes(problem: BaseException) -> str:
    return "".join(f", {note}" for note in getattr(problem, "__notes__", ()))


def _where(problem: BaseException) -> str:
    """Innermost line in the folder of what simgrab called: not in a package that it uses."""
    steps = [step for step in traceback.extract_tb(problem.__traceback__) if not _inside(step.filename)]
    own = [step for step in steps if _beside(Path(step.filename), Path(steps[0].filename).parent)]
    return f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""


def _beside(file: Path, folder: Path) -> bool:
    return file.is_relative_to(folder) and "site-packages" not in file.relative_to(folder).parts


def _inside(file: str) -> bool:
    return file.startswith("<frozen") or PACKAGE in Path(file).parents or file.endswith("importlib/__init__.py")
