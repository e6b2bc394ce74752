"""From a video to angles and alarms: the work of `simgrab run`."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from simgrab.errors import RunError, SourceError
from simgrab.instrument import alarm
from simgrab.instrument.contract import Frame, Instrument, Measurement
from simgrab.instrument.estimate.follow import Known
from simgrab.instrument.estimate.measure import estimate_json
from simgrab.instrument.faults import Backlog, Fault
from simgrab.instrument.pipeline import Live, MeasuredRecord, Pipeline, assemble
from simgrab.instrument.run import runs
from simgrab.instrument.run.assumed import CONTRADICTS, assumptions
from simgrab.instrument.run.runs import Progress, Run
from simgrab.instrument.run.subject import checked
from simgrab.instrument.run.video import OverlayVideo
from simgrab.instrument.source import PictureFiles, Source, camera_beside, fitting, open_source
from simgrab.io.destination import check_new_folder
from simgrab.model import calibration as camera_file
from simgrab.model.calibration import Calibration
from simgrab.text import encodable

VIDEO, PAGE, TILT = "annotated.mp4", "report.html", "tilt.toml"
EDGE_PX = 3.0  # from the edge of a picture to a box that reaches it
PART_S = 3600.0  # of a live run in one folder, which bounds the memory


@dataclass(frozen=True)
class RunOptions:
    """Options of a run."""

    # whether to compute angles as frames arrive, with a tilt that is estimated repeatedly; a stream is always live
    live: bool = False
    video: bool = True  # whether to write the annotated video
    rate_hz: float | None = None  # frame rate of pictures in a folder, or of a video without time stamps
    paper: bool = False  # whether the report compares with the paper's figures of its own video


def run(
    source: str | Path,
    camera: str | Path | Calibration | None = None,
    out: str | Path | None = None,
    instrument: Instrument | None = None,
    options: RunOptions | None = None,
    progress: Progress | None = None,
    report: Callable[[str], None] | None = None,
) -> Run:
    """Measure a source, and write the results into a new folder if one is given.

    Parameters
    ----------
    source : str or path
        As `simgrab.instrument.source.open_source` takes it.
    camera : path or Calibration, optional
        Camera TOML; by default the one beside or in the source.
    out : path, optional
        Folder, made once tables, alarms, annotated video and report are complete. Without it nothing is written.
    instrument : Instrument, optional
        simgrab's own pipeline unless given.
    options : RunOptions, optional
    progress : callable, optional
        Called with how many frames are measured, and of how many.
    report : callable, optional
        Called with a line about each fault of a live run as it is found, and about each folder written before the end.

    Returns
    -------
    Run
        The whole one; of a live one with ``out`` what the last folder holds: every `PART_S` a new one is begun.

    Raises
    ------
    SourceError, CalibrationError, DetectorError, ReaderError, InstrumentError, RecordError, RunError
        With one line that states the problem; ``out`` is then not made.
    """
    options = options or RunOptions()
    if out is not None:
        check_new_folder(Path(out), RunError)
    named: dict[str, Any] = {}
    if not isinstance(camera, Calibration):
        camera = camera_beside(source) if camera is None else camera
        named["camera"] = encodable(camera)
        camera = camera_file.load(camera)
    opened = open_source(source, rate_hz=options.rate_hz)
    if isinstance(opened, PictureFiles) and opened.labels_sha256:
        named["labels_sha256"] = opened.labels_sha256
    live = options.live or opened.live
    instrument = instrument or assemble(live=live)
    if (
        opened.live
        and isinstance(instrument, Pipeline)
        and (instrument.controller is not None or (instrument.estimator is not None and instrument.estimator.needs_imu))
    ):
        raise RunError("a stream cannot be used with recorded readings of a sensor or controller: their times differ")
    parts = _Parts(opened, camera, instrument, progress, report or (lambda _: None)) if live else None

    def measured(folder: Path | None) -> tuple[Callable[[], Run], OverlayVideo]:
        if parts is not None:
            return parts.next(folder, options)
        found, overlay = _whole(opened, camera, instrument, options, folder, progress)
        return lambda: found, overlay

    def concluded(conclude: Callable[[], Run]) -> Run:
        found = conclude()
        return replace(found, about=found.about | named)

    if out is None:
        return concluded(measured(None)[0])

    def write(making: ExitStack, folder: Path, conclude: Callable[[], Run], overlay: OverlayVideo) -> Run:
        with making:
            found = concluded(conclude)
            _write(found, overlay, folder, paper=options.paper)
        return found

    numbers, target = itertools.count(2), Path(out)
    with ThreadPoolExecutor(1) as writer:  # beside which the stream is measured on
        while True:
            try:
                with ExitStack() as making:
                    folder = making.enter_context(runs.making(target))
                    conclude, overlay = measured(folder)
                    if parts is not None:
                        parts.check_written()
                    args = making.pop_all(), folder, conclude, overlay
            except Exception as problem:
                if parts is not None:
                    parts.add_writing_to(problem)
                raise
            if parts is None or parts.ended:
                return write(*args)
            parts.writing = target, writer.submit(write, *args)
            del conclude, overlay, args  # which hold the rows of the part
            further = (Path(out).with_name(f"{Path(out).name}-{number}") for number in numbers)
            target = next(path for path in further if not os.path.lexists(path))


def _write(found: Run, overlay: OverlayVideo, folder: Path, *, paper: bool) -> None:
    runs.save(found, folder)
    if found.about["tilt"] is not None:
        tilt = msgspec.convert(found.about["tilt"], Known)
        (folder / TILT).write_text(tilt.to_toml(), encoding="utf-8")
    from simgrab.instrument.run.page import page  # matplotlib takes its time

    (folder / PAGE).write_text(page(found, overlay.stills, paper=paper), encoding="utf-8")


def measure(
    frames: Iterable[Frame],
    calibration: Calibration,
    instrument: Instrument,
    *,
    source: str = "",
) -> Run:
    """Measure a record, writing nothing.

    Raises
    ------
    SourceError
        If there is no frame, or the pictures are not of this camera.
    InstrumentError
        If the instrument breaks its contract, or raises an error.
    RecordError
        If the instrument raises it, because it cannot use the record.
    RunError
        If the number of measurements differs from the number of frames.
    """
    instrument = checked(instrument)
    notes = _Notes()
    begun = time.perf_counter()
    passed = fitting(notes.of(frames), calibration)
    record = instrument.record(passed, calibration) if isinstance(instrument, Pipeline) else None
    measured = record.measurements if record is not None else tuple(instrument(passed, calibration))
    seconds = time.perf_counter() - begun
    if not notes.names:
        raise SourceError(f"{source}: it contains no frames")
    if len(measured) != len(notes.names):
        raise RunError(f"{len(measured)} measurements of {len(notes.names)} frames; one for each frame is required")
    tilt = None if record is None else record.tilt
    return _conclude(notes, measured, calibration, instrument, source, record, tilt, seconds)


def _whole(
    source: Source, calibration: Calibration, instrument: Instrument, options: RunOptions, folder: Path | None,
    progress: Progress | None,
) -> tuple[Run, OverlayVideo]:  # fmt: skip
    """Measure, then read the source again for the annotated video; it must give the same frames.

    The drawn angles are known only after the whole record is measured, and its pictures are too many to keep.
    """
    frames = _counted(source, progress)
    found = measure(frames, calibration, instrument, source=source.name)
    with OverlayVideo(folder / VIDEO if folder and options.video else None) as overlay:
        if folder is None:
            return found, overlay
        again = _Notes()
        for frame, measured in zip(again.of(fitting(iter(source), calibration)), found.measurements, strict=False):
            overlay.add(frame, measured)
    again.check_against(found)
    return found, overlay


class _Parts:
    """A live run, measured and annotated at once, in parts; an interrupt ends it, as the end of the stream does."""

    def __init__(
        self, source: Source, calibration: Calibration, instrument: Instrument, progress: Progress | None,
        report: Callable[[str], None],
    ) -> None:  # fmt: skip
        if not isinstance(instrument, Pipeline):
            raise RunError(f"{instrument.name} cannot measure frame by frame; a live run needs simgrab's own pipeline")
        self.ended = False
        self.writing: tuple[Path, Future[Run]] | None = None  # the part before
        self._source, self._calibration, self._instrument = source, calibration, instrument
        self._report, self._backlog = report, Backlog() if source.live else None
        self._live = iter(instrument.live(fitting(_counted(source, progress), calibration), calibration))
        self._first: Live | None = None  # of the next part
        used = instrument.tilt or instrument.chosen(calibration, live=True)
        given = f"given, of {used.estimator}" if isinstance(used, Known) else f"by {used.name}"
        plc = instrument.controller or instrument.feed
        rope = "; of the controller the rope length is used"
        rope += " where the display shows none: its clock is not known" if instrument.display_first else ""
        more = ", and the jib's motion for warnings" if instrument.foresees else ""
        report(f"tilt: {given}{rope + more if plc else ''}")

    def check_written(self) -> None:
        """Wait until the part before is written; raise what prevented it."""
        if self.writing is not None:
            (target, future), self.writing = self.writing, None
            try:
                future.result()
            except KeyboardInterrupt:
                self.ended = True
                future.result()
            self._report(f"written: {target}")

    def add_writing_to(self, problem: Exception) -> None:
        """Note with what ended the run what prevented the part before from being written."""
        try:
            self.check_written()
        except Exception as other:
            problem.add_note(str(other))

    def next(self, folder: Path | None, options: RunOptions) -> tuple[Callable[[], Run], OverlayVideo]:
        """Measure one part, all of it where no folder is written; its results follow when they are called for."""
        notes = _Notes()
        measured: list[Measurement] = []
        latency: list[float] = []
        faults: list[Fault] = []
        tilt: Known | None = None
        begun = time.perf_counter()
        with OverlayVideo(folder / VIDEO if folder and options.video else None) as overlay:
            try:
                first = next(self._live, None) if self._first is None else self._first
                for one in itertools.chain([first] if first else [], self._live):
                    assert first is not None
                    if self.writing is not None and self.writing[1].done():
                        self.check_written()
                    if folder and (one.frame.time_s or 0) >= (first.frame.time_s or 0) + PART_S:
                        self._first = one
                        break
                    notes.add(one.frame)
                    measured.append(one.measurement)
                    latency.append(one.seconds)
                    tilt = one.tilt
                    at, found = one.frame.time_s or 0.0, list(one.faults)
                    if self._backlog and (text := self._backlog.step(time.monotonic(), at)):
                        found.append(Fault(at, "source", text))
                    faults += found
                    for fault in found:
                        self._report(f"{fault.time_s:.1f} s: {fault.kind}: {fault.text}")
                    overlay.add(one.frame, one.measurement)
                else:
                    self.ended = True
            except KeyboardInterrupt:
                if not measured:
                    raise
                self.ended = True
        if not measured:
            raise SourceError(f"{self._source.name}: it contains no frames")
        seconds = time.perf_counter() - begun

        def conclude() -> Run:
            found = _conclude(
                notes, measured, self._calibration, self._instrument, self._source.name, None, tilt, seconds
            )
            median, p99 = np.quantile(latency, [0.5, 0.99]).tolist()
            speed = found.about["speed"] | {"latency_median_s": median, "latency_p99_s": p99}
            return replace(found, about=found.about | {"speed": speed, "faults": msgspec.to_builtins(faults)})

        return conclude, overlay


class _Notes:
    """Times, names and notes of past frames, without their pictures."""

    def __init__(self) -> None:
        self.times: list[float | None] = []
        self.names: list[str] = []
        self.notes: dict[str, None] = {}  # each once, in order

    def of(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        for frame in frames:
            self.add(frame)
            yield frame

    def add(self, frame: Frame) -> None:
        self.times.append(frame.time_s)
        self.names.append(frame.name)
        if frame.note:
            self.notes[frame.note] = None

    def check_against(self, run: Run) -> None:
        """Refuse frames that differ from those of a run."""
        times = [None] * len(run.names) if run.time is None else run.time.tolist()
        first, here = list(zip(times, run.names, strict=True)), list(zip(self.times, self.names, strict=True))
        if first == here:
            return
        k = next((k for k, (a, b) in enumerate(zip(first, here, strict=False)) if a != b), min(len(first), len(here)))
        raise SourceError(
            f"{run.source}: it changed while it was measured: {len(first)} frames at first, then {len(here)} when read "
            f"again for the annotated video, other ones from frame {k} on"
        )


def _counted(source: Source, progress: Progress | None) -> Iterator[Frame]:
    for done, frame in enumerate(source, 1):
        yield frame
        if progress:
            progress(done, source.count)


def _conclude(
    notes: _Notes, measured: Iterable[Measurement], calibration: Calibration, instrument: Instrument, source: str,
    record: MeasuredRecord | None, tilt: Known | None, seconds: float,
) -> Run:  # fmt: skip
    measurements = tuple(measured)
    time_s = None if None in notes.times else np.array(notes.times, float)
    found = () if time_s is None else alarm.events(time_s, measurements)
    early = () if time_s is None else alarm.events(time_s, measurements, alarm.WARNED_AT, alarm.warning)
    estimate = None if record is None else record.estimate
    reported = _controller(instrument, record)
    cut = _at_edge(measurements, calibration)
    assumed = assumptions(calibration, record, tilt, instrument, measurements, timed=time_s is not None)
    beyond = [f"{CONTRADICTS}: {assumed['beyond']}"] * bool(assumed["beyond"])
    about = {
        "simgrab": version("simgrab"),
        "counts": runs.counts(measurements),
        "estimate": None if estimate is None else estimate_json(estimate),
        "tilt": None if tilt is None else msgspec.to_builtins(tilt),
        "assumed": assumed,
        "above_10_deg": alarm.share(*np.array([(m.alpha, m.alpha_low, m.alpha_high) for m in measurements], float).T),
        "warnings": runs.alarms(early),
        "notes": [*notes.notes, *reported.pop("notes", ()), *cut, *beyond],
        "speed": {"frames": len(measurements), "seconds": seconds, "frames_per_s": len(measurements) / seconds},
    } | ({"controller": reported} if reported else {})  # fmt: skip
    return Run(instrument.name, source, calibration, time_s, tuple(notes.names), measurements, found, about)


def _at_edge(measurements: Iterable[Measurement], calibration: Calibration) -> list[str]:
    """Name frames in which the picture may cut off a part of the grab, of which the centre is less exact."""
    right, bottom = calibration.width_px - EDGE_PX, calibration.height_px - EDGE_PX
    boxes = [m.box for m in measurements if m.status == "ok" and m.box is not None]
    cut = sum(min(x0, y0) < EDGE_PX or x1 > right or y1 > bottom for x0, y0, x1, y1 in boxes)
    return [f"frames whose box reaches the picture's edge, so that the centre is less exact: {cut}"] * bool(cut)


def _controller(instrument: Instrument, record: MeasuredRecord | None) -> dict[str, Any]:
    """State what is known of the controller's clock, its wind, and what was refused; empty without its data."""
    if not isinstance(instrument, Pipeline) or instrument.controller is None:
        return {}
    controller = instrument.controller
    clock = (record.clock if record is not None else None) or controller.stated_clock
    by_swing, used = None, None if record is None else record.estimator
    if record is not None and record.estimate is not None and used is not None and not used.needs_imu:
        by_swing = clock.by_swing(*map(record.estimate.diagnostics.get, ("clock_s", "clock_sd_s")))
    time = controller.time if record is None or record.arrays.time is None else record.arrays.time
    if record is None:
        unused = "live runs do not use it"
    elif getattr(used, "controller", None) is None:
        unused = "it needs --imu, or slewing or luffing by --plc"
    else:
        unused = "" if np.ptp(controller.lightness(time)) else "it does not change"
    return {
        "clock_offset_s": clock.offset_s, "clock_interval_s": list(clock.interval_s), "clock_from": clock.source,
        "clock_by_motion_s": None if by_swing is None else by_swing.offset_s,
        "clock_by_motion_interval_s": None if by_swing is None else list(by_swing.interval_s),
        "clock_used_s": (by_swing or clock).offset_s,
        "wind_m_s": None if controller.wind is None else controller.wind_m_s(time),
        "load_unused": None if controller.load is None else unused,
        "display_minus_controller_m": clock.difference_m,
        "notes": [*controller.notes, *filter(None, [clock.note, record.doubt if record is not None else ""])],
    }  # fmt: skip
