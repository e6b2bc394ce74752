"""The paper's system as one instrument: detect, read, undistort, calibrate the tilt, and then frame by frame."""

from __future__ import annotations

import math
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RunError
from simgrab.instrument import angles
from simgrab.instrument.angles import RecordArrays
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.controller import DELAY_S, DELAY_SD_S, OLDEST_S, ClockOffset, Controller
from simgrab.instrument.detect import BUNDLED, Detector
from simgrab.instrument.detect import detector as opened
from simgrab.instrument.estimate import DEFAULT, ESTIMATORS, Estimator
from simgrab.instrument.estimate.follow import Known, known, load
from simgrab.instrument.estimate.intervals import WORKING, IntervalSettings
from simgrab.instrument.estimate.solve import informed, on_clock, solve, stated_ends, with_weak_prior
from simgrab.instrument.faults import Fault, FaultWatch
from simgrab.instrument.forecast import MIDDLES_S, Forecaster
from simgrab.instrument.observation import Observation, observe, one
from simgrab.instrument.read import Reader
from simgrab.instrument.rope import rope
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate

if TYPE_CHECKING:
    from simgrab.instrument.controller_feed import ControllerFeed

T = TypeVar("T")

WITH_MOTION, WITH_ROPE, WITHOUT = "pendulum-smoother", "rope-aware", DEFAULT
WARM_UP_S = 20.0  # of a live record before its first tilt: a swing or two, and most of a hoist
AGAIN_S = 10.0  # between re-estimates of it
KEPT_S = 1200.0  # of a live record
IMU, PLC = "imu0", "plc"  # among sensors: in the camera's housing, and the crane's controller
UNSURE_M = 0.3  # of a radius that was not reported for a while: the next one turns no camera
ARRIVAL_SD_S = 0.3  # of a clock by the arrival of rows
LATE_S = math.hypot(DELAY_S, DELAY_SD_S)  # a controller's clock that may be further off is worse than a late display
WINDOW_S = 10.0  # of readings that a live one is compared with


@dataclass(frozen=True)
class MeasuredRecord:
    """Result of an instrument for a record of n frames."""

    arrays: RecordArrays
    measurements: tuple[Measurement, ...]
    estimate: Estimate | None  # estimate of the tilt, or its refusal; None if the tilt was given
    tilt: Known | None  # tilt with which the swings were computed; None if there was none
    clock: ClockOffset | None = None  # offset of the controller's clock; None without its data
    estimator: Estimator | None = None  # what made the estimate, with the readings that it used
    # what the swing contradicts, as `simgrab.instrument.estimate.doubts.doubt` returns it; mostly empty
    doubt: str = ""
    pitched: bool = False  # whether the tilt followed the radius of the rope exit


@dataclass(frozen=True)
class Pipeline:
    """Frames to angles (`simgrab.instrument.contract.Instrument`).

    Attributes
    ----------
    detector : Detector
    reader : Reader or None
    estimator : Estimator or None
        By default `RopeAware` if a display or the controller states the rope's length, because the camera hangs beside
        the rope exit. With that offset of 0.6 m, known to 5 cm, `RopeAware` errs by 0.17° in five minutes of calm
        working cycles; estimators without the rope's length err by 0.6° and more (docs/results/estimators.md).
        `PendulumSmoother` errs by 0.16°, takes a second or two, and cannot work frame by frame; it is the default for a
        whole record whose controller reports slewing or luffing. Without a rope length the default is `MeanRay`.
    calibrate_s : float or None
        Seconds at the beginning from which the tilt is estimated; None for the whole record, as in the paper.
    tilt : Known or None
        A known tilt.
    controller : Controller or None
        Readings of the crane's controller. Its rope length takes the place of the display's, except in a live run on a
        clock that is not known, and an estimator with a field ``controller`` gets all of it.
    feed : ControllerFeed or None
        Files of readings that a live run follows instead.
    """

    detector: Detector
    reader: Reader | None
    estimator: Estimator | None = None
    calibrate_s: float | None = None
    tilt: Known | None = None
    controller: Controller | None = None
    feed: ControllerFeed | None = None
    intervals: IntervalSettings = WORKING

    def __post_init__(self) -> None:
        """Refuse an estimator of another kind."""
        if self.estimator is not None and not isinstance(self.estimator, Estimator):
            raise RunError(
                f"estimator: {type(self.estimator).__name__} does not derive from simgrab's Estimator; "
                "use it in an instrument of your own (docs/own-pipeline.md)"
            )

    @property
    def name(self) -> str:
        """Name in reports."""
        return f"simgrab with the detector {self.detector.name}"

    @property
    def display_first(self) -> bool:
        """Whether a live run takes the display's rope length where it is read.

        That is so where the controller's clock may be further off than a display is late.
        """
        return self.controller is not None and self.controller.clock_sd_s > LATE_S

    @property
    def reports_radius(self) -> bool:
        """Whether a live run knows the radius of the rope exit, by which some cameras pitch."""
        if self.feed is not None:
            return self.feed.states_radius
        return self.controller is not None and self.controller.radius is not None and not self.display_first

    @property
    def foresees(self) -> bool:
        """Whether a live run's forecasts use how the controller's slewing and luffing move the jib."""
        if self.feed is not None:
            return self.feed.states_motion
        known = self.controller
        return self.reports_radius and known is not None and known.slew is not None and known.motion_late_s < OLDEST_S

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:
        """Measure a record."""
        return self.record(frames, calibration).measurements

    def chosen(self, calibration: Calibration, *, live: bool = False) -> Estimator:
        """Choose the estimator for a camera.

        Raises `RunError` if the estimator needs the rope's length, and neither a display nor the controller states it,
        or the whole record of a live run.
        """
        known = calibration.digit_layout is not None and self.reader is not None
        known = known or (self.controller is not None and self.controller.rope is not None)
        known = known or (self.feed is not None and self.feed.states_rope)
        if self.estimator is None:
            whole = not live and self.calibrate_s is None and self.tilt is None
            moves = self.controller is not None and self.controller.reports_motion
            name = WITH_MOTION if known and whole and moves else WITH_ROPE if known else WITHOUT
            return ESTIMATORS[name](intervals=self.intervals)
        if self.estimator.needs_rope and not known:
            raise RunError(
                f"{self.estimator.name} needs the rope's length, but the camera file states no display "
                f"(digit_layout), and there is none of the controller; {WITHOUT} needs no rope length"
            )
        if live and self.estimator.needs_time and not self.estimator.needs_imu:
            raise RunError(f"{self.estimator.name} needs the whole record; name another estimator for a live run")
        return self.estimator

    def check_inputs(self, sensors: Collection[str], *, display: bool) -> None:
        """Refuse inputs that the pipeline cannot measure with, before there is a record.

        Parameters
        ----------
        sensors : collection of str
            Names of the sensors for `with_sensors`; without any it is not called.
        display : bool
            Whether camera files state a display.

        Raises
        ------
        RunError
            With one line that names the missing input.
        """
        name = self.estimator.name if self.estimator is not None and self.estimator.needs_rope else ""
        if sensors:
            self._check_sensors(sensors)
            name = WITH_MOTION if IMU in sensors else name
        if name and PLC not in sensors and not (display and self.reader is not None):
            raise RunError(f"{name} needs the rope's length on the display")

    def _check_sensors(self, sensors: Collection[str]) -> None:
        if IMU in sensors and (self.estimator is not None or self.calibrate_s is not None or self.tilt is not None):
            raise RunError("an inertial sensor selects its own estimator; leave out estimator and calibration")
        if IMU not in sensors and PLC not in sensors:
            raise RunError(f"{self.name} uses the sensors {IMU} and {PLC}; there are: {', '.join(sensors) or 'none'}")

    def with_sensors(self, sensors: Mapping[str, Path]) -> Pipeline:
        """Measure with sensors (`TakesSensors`).

        These are ``plc``, the controller's data, and ``imu0``, the inertial sensor in the camera's housing, with which
        the estimator is `PendulumSmoother`.

        Raises
        ------
        RunError
            If there is neither, or an estimator or a tilt was chosen beside ``imu0``.
        RecordError
            If readings cannot be used.
        """
        self._check_sensors(sensors)
        found = self
        if IMU in sensors:
            from simgrab.instrument.estimate import PendulumSmoother
            from simgrab.instrument.estimate.inertial.readings import read_imu

            found = replace(found, estimator=PendulumSmoother(imu=read_imu(sensors[IMU]), intervals=self.intervals))
        if PLC in sensors:
            from simgrab.instrument.controller_file import read_controller

            found = replace(found, controller=read_controller(sensors[PLC]))
        return found

    def record(self, frames: Iterable[Frame], calibration: Calibration) -> MeasuredRecord:
        """Measure a record, and return the tilt that was used."""
        self.chosen(calibration)
        observations = tuple(observe(ahead(frames), self.detector, self.reader, calibration))
        return self.conclude(observations, calibration)

    def conclude(self, observations: Sequence[Observation], calibration: Calibration) -> MeasuredRecord:
        """Estimate angles from a record of observations."""
        record = angles.arrays(observations, *rope(observations, calibration))
        controller, clock = self.controller, None
        if controller is not None:
            controller, clock = on_clock(controller, record)
        when, until_s = record.time, self.calibrate_s
        if when is not None and until_s is not None and len(when):
            when = when[when < when[0] + until_s]
        estimator = informed(self.chosen(calibration), controller, record.pixel_sd, when)
        estimate, tilt, why = None, self._tilt(calibration), ""
        if tilt is not None:
            record = record.with_lengths(controller)
        else:
            if until_s is not None and record.time is None:
                raise RunError("independent frames have no first part to calibrate on")
            record, estimate, why = solve(record, calibration, estimator, controller, until_s)
            if not estimate.ok:
                nothing = np.full((len(observations), 3), np.nan)
                refused = f"no tilt: {estimate.reason}"
                measured = angles.measurements(
                    record, nothing[:, 0], nothing[:, 1:], refused, needs_rope=estimator.needs_rope
                )
                return MeasuredRecord(record, measured, estimate, None, clock)
            tilt = known(estimate, calibration)
        radii = None
        if controller is not None and record.time is not None and controller.clock_sd_s <= LATE_S:
            radii = controller.radii(record.time)
        alpha, ends, swing = angles.by_tilt(record, tilt, calibration, radii)
        if estimate is not None and until_s is None:
            assert estimate.alpha is not None
            alpha, ends = estimate.alpha, stated_ends(estimate)
        measures_lean = moving(estimator) and estimate is not None and until_s is None
        pitched = tilt.pitched(radii)
        firm = ends if record.time is None or measures_lean else angles.without_lean(alpha, ends, calibration, pitched)
        ahead_s = None
        if estimate is None or not moving(estimator):
            # Forecasts rest on the tilt of all of the record, but on no later frames.
            ahead_s = angles.forecasts(Forecaster(), record, swing, alpha, firm, calibration.focal_length_px)
        stated = swing if still(calibration, estimator) else None
        if estimate is not None and until_s is None and estimate.swing is not None:
            stated = estimate.swing
        measured = angles.measurements(record, alpha, ends, ahead=ahead_s, swing=stated, firm=firm)
        followed = pitched is not None and bool(pitched.any())
        return MeasuredRecord(record, measured, estimate, tilt, clock, estimator, why, followed)

    def _tilt(self, calibration: Calibration) -> Known | None:
        """Return the given tilt, for the camera's roll."""
        return None if self.tilt is None else self.tilt.on(calibration.mount).rolled(calibration.roll_deg)

    def live(self, frames: Iterable[Frame], calibration: Calibration) -> Iterator[Live]:
        """Measure frames as they come; the tilt is re-estimated every few seconds from those of the last minutes."""
        estimator = self.chosen(calibration, live=True)
        tracker = None
        if estimator.needs_imu:
            from simgrab.instrument.estimate.inertial.live import InertialTracker

            tracker = InertialTracker(estimator, calibration)
        observations: list[Observation] = []
        lengths: list[float] = []
        tilt, start, due = self._tilt(calibration), math.nan, WARM_UP_S
        estimated = tilt is None and tracker is None
        forecaster, watch, before, last = Forecaster(), FaultWatch(), tilt, None
        for frame in ahead(frames):
            begun = time.perf_counter()
            at = frame.time_s
            if at is None:
                raise RunError("a live run needs frames that follow each other in time")
            observations.append(one(frame, self.detector, self.reader, calibration))
            start = at if math.isnan(start) else start
            controller = self.controller if self.feed is None else self.feed.poll(at)
            recent = observations[_before(observations, at - WINDOW_S) :]
            length, jump = rope(recent, calibration)
            newest = angles.arrays(recent[-1:], length[-1:], jump[-1:])
            if controller is not None:
                unlike = watch.unlike
                watch.clock(at, controller, float(newest.rope_length[0]))
                forecaster = forecaster if watch.unlike == unlike else Forecaster()  # of ropes of other lengths
            if not ((self.display_first or watch.unlike) and np.isfinite(newest.rope_length[0])):
                newest = newest.with_lengths(controller)
            lengths.append(float(newest.rope_length[0]))
            radii = None
            if controller is not None and self.reports_radius:
                radii = controller.radii(np.array([at]), ARRIVAL_SD_S if self.feed else None, live=True)
            if at - start >= due:
                due = at - start + AGAIN_S
                old = _before(observations, at - KEPT_S)
                del observations[:old], lengths[:old]
                if estimated:
                    whole = angles.arrays(observations, np.array(lengths))
                    windy = estimator.in_wind(self.controller, whole.time)
                    found = whole.estimate(windy, calibration)
                    if found.ok:
                        found = with_weak_prior(found, whole, windy, calibration)
                        tilt = known(found, calibration)
            pitched: NDArray[np.bool_] | None = None
            alpha, ends, swing, waits = np.full(1, np.nan), np.full((1, 2), np.nan), np.full((1, 2), np.nan), ""
            if tracker is not None:
                alpha[0], ends[0] = tracker.step(at, observations[-1].centre, lengths[-1])
                swing[0], waits = tracker.direction, tracker.waiting
            elif tilt is None:
                waits = f"no tilt yet: {at - start:.0f} s of {WARM_UP_S:.0f}"
            else:
                alpha, ends, swing = angles.by_tilt(newest, tilt, calibration, radii)
                pitched = tilt.pitched(radii)
                guessed = last is None or not (np.isfinite(last.value[0]) and last.sd[0] < UNSURE_M)
                if before is not None and (before is not tilt or (guessed and pitched is not None)):
                    by = swing - angles.by_tilt(newest, before, calibration, last if guessed else radii)[2]
                    forecaster.shift(by)
                    watch.shift(by)
            firm = ends if tracker is not None else angles.without_lean(alpha, ends, calibration, pitched)
            motion: Sequence[Array] = ()
            if controller is not None and self.foresees:
                motion = controller.jib_motion(at, MIDDLES_S)
            ahead_s = angles.forecasts(forecaster, newest, swing, alpha, firm, calibration.focal_length_px, motion)
            known_way = swing if tracker is None and still(calibration, estimator) else None
            (measured,) = angles.measurements(newest, alpha, ends, waits, ahead_s, known_way, firm=firm)
            watch.frame(frame, measured)
            if self.feed is not None:
                watch.controller(at, controller, self.feed)
            used, before, last = tilt, tilt, radii
            sd = newest.direction_sd(calibration.focal_length_px)
            if tracker is None and watch.knock(at, swing, sd, newest.rope_length):
                tilt, estimated, forecaster, start, due = None, True, Forecaster(), watch.since, WARM_UP_S
                old = _before(observations, start)
                del observations[:old], lengths[:old]
            seconds = time.perf_counter() - begun
            yield Live(frame, measured, used, seconds, watch.found(at))


@dataclass(frozen=True, eq=False)
class Live:
    """One frame of a live record: its measurement, the tilt used, the time taken, s, and faults found."""

    frame: Frame
    measurement: Measurement
    tilt: Known | None
    seconds: float
    faults: tuple[Fault, ...]


def ahead(items: Iterable[T], most: int = 3) -> Iterator[T]:
    """Make the next few items in a thread, in order; an error is raised at its item.

    Decoding and detection release Python's lock, so that each gets a core. At most ``most`` items wait.
    """
    end = object()
    source = iter(items)
    with ThreadPoolExecutor(1) as thread:
        waiting = deque(thread.submit(next, source, end) for _ in range(most))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, source, end))
            yield item  # type: ignore[misc]  # not the end, hence a T
            del item  # a picture must not be kept while the next is awaited


def moving(estimator: Estimator | None) -> bool:
    """Whether an estimator takes the camera as one that moves."""
    return estimator is not None and (estimator.needs_imu or getattr(estimator, "controller", None) is not None)


def still(calibration: Calibration, estimator: Estimator | None) -> bool:
    """Whether a camera is taken not to move, so that its tilt shows where the grab swings to."""
    return calibration.mount == "fixed" or (not calibration.mount and not moving(estimator))


def _before(observations: Sequence[Observation], time_s: float) -> int:
    """Count the observations of a live record before a time."""
    return bisect_left(observations, time_s, key=lambda observation: observation.time_s or 0.0)


def assemble(
    *,
    detector: str | Path = BUNDLED,
    estimator: str | None = None,
    calibrate_s: float | None = None,
    tilt: str | Path | None = None,
    live: bool = False,
    imu: str | Path | None = None,
    plc: str | Path | None = None,
    follow: bool = False,
    wind_m_s: float = 0.0,
) -> Pipeline:
    """Make a pipeline; without options the default detector, reader and estimator on the whole record.

    Parameters
    ----------
    detector : str or path
        As `simgrab.instrument.detect.detector` takes it.
    estimator : str, optional
        A name in `ESTIMATORS`.
    tilt : path, optional
        A ``tilt.toml``.
    live : bool
        Whether the pipeline is for a live run.
    imu : path, optional
        Folder of the inertial sensor in the camera's housing, as `read_imu` takes it: then the estimator is
        `PendulumSmoother`.
    plc : path, optional
        Data of the crane's controller, as `simgrab.instrument.controller_file.read_controller` takes them.
    follow : bool
        Whether the controller's data grow during the run, a live one: then only new rows are read.
    wind_m_s : float
        As `simgrab.instrument.estimate.IntervalSettings` takes it.

    Raises
    ------
    RunError, DetectorError, CalibrationError, RecordError
        If settings exclude each other, or a file is invalid.
    """
    if estimator is not None and estimator not in ESTIMATORS:
        raise RunError(f"unknown estimator {estimator!r}; there are: {', '.join(ESTIMATORS)}")
    if calibrate_s is not None and (tilt is not None or live):
        other = "a live run, which calibrates continuously" if live else "a calibration that is given"
        raise RunError(f"calibration on the first part cannot be combined with {other}")
    if estimator is not None and tilt is not None:
        raise RunError(f"the tilt is given, so {estimator} is not needed; leave out one of them")
    stated = replace(WORKING, wind_m_s=wind_m_s)
    chosen: Estimator | None = None if estimator is None else ESTIMATORS[estimator](intervals=stated)
    known = None if tilt is None else load(tilt)
    pipeline = Pipeline(opened(detector), Reader(), chosen, calibrate_s, known, intervals=stated)
    if plc is not None and follow:
        from simgrab.instrument.controller_feed import ControllerFeed

        pipeline, plc = replace(pipeline, feed=ControllerFeed(plc)), None
    sensors = {name: Path(path) for name, path in ((IMU, imu), (PLC, plc)) if path is not None}
    return pipeline.with_sensors(sensors) if sensors else pipeline
