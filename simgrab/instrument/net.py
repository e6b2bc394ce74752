"""Opens ONNX files and runs them.

onnxruntime and not cv2.dnn: on one core two nets took 7.5 and 3.4 ms against 17 and 9 (OpenCV 5.0.0), and what cv2.dnn
returned was off by up to 0.3. It also reports a file's shapes and metadata, which are checked before use.

A file is read completely and passed as bytes; it cannot name further files. Limits apply to the file's bytes, the
numbers in an output, memory and time. They do not apply to the memory of constants that onnxruntime computes when
loading a net, nor to the time of a single operator, which cannot be interrupted.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # else 1.31 keeps an identifier and reports to Microsoft
import onnxruntime

from simgrab.errors import DetectorError, SimgrabError, first_line, one_line
from simgrab.instrument import onnx_parts
from simgrab.instrument.deadline import within
from simgrab.io.parse import parse_json, read_bytes

THREADS = 2
KEY = "simgrab"  # of the metadata in our own files

MOST_BYTES = 2**30  # of a file
MOST_NUMBERS = 2**26  # in an output
MOST_MEMORY = 4 * 2**30  # bytes of all nets of a process together, while they run
MOST_SECONDS = 120.0  # of loading, and of a run
MOST_METADATA = 100_000  # characters of an entry that is read


@dataclass(frozen=True, eq=False)
class Net:
    """An ONNX file that can be run."""

    path: Path
    session: onnxruntime.InferenceSession
    # inputs, outputs: shapes by name; a free dimension is None
    inputs: Mapping[str, tuple[int | None, ...]]
    outputs: Mapping[str, tuple[int | None, ...]]
    types: tuple[str, ...]  # types of the inputs, as onnxruntime names them
    facts: dict[str, Any]  # metadata written by simgrab; empty for other files
    metadata: Mapping[str, str]  # all metadata of the file, except entries of more than `MOST_METADATA` characters
    refuse: Callable[[str], SimgrabError] = DetectorError  # makes the error to raise from a message

    def __call__(
        self, pictures: NDArray[np.generic], names: Sequence[str] | None = None
    ) -> list[NDArray[np.floating[Any]]]:
        """Run a batch.

        Parameters
        ----------
        pictures : ndarray
            Pictures of the shape in `inputs`.
        names : sequence of str, optional
            Names of the outputs that are returned; others may be of any type. By default all, in the order of
            `outputs`.

        Raises
        ------
        SimgrabError
            Made by `refuse`, if the net does not run, exceeds a limit, or outputs anything but floats.
        """
        names = list(self.outputs) if names is None else names
        options = onnxruntime.RunOptions()
        options.log_severity_level = _FATAL
        try:
            with within(MOST_SECONDS, lambda: setattr(options, "terminate", True)):
                found = list(self.session.run(names, {next(iter(self.inputs)): pictures}, options))
        except Exception as problem:  # onnxruntime's errors have no common base
            raise self.refuse(f"{self.path} does not run: {_why(problem)}") from None
        for name, out in zip(names, found, strict=True):
            if not isinstance(out, np.ndarray) or out.dtype.kind != "f":
                raise self.refuse(f"{self.path}: its output {one_line(name)} is not an array of floats")
            if out.size > MOST_NUMBERS:
                raise self.refuse(f"{self.path}: its output {one_line(name)} has more than {MOST_NUMBERS} numbers")
        return found

    def __str__(self) -> str:
        def listed(shapes: Mapping[str, tuple[int | None, ...]]) -> str:
            return ", ".join(f"{name} {' x '.join(str(s or '?') for s in shape)}" for name, shape in shapes.items())

        kinds = "" if set(self.types) <= {"tensor(float)"} else f" of {', '.join(self.types)}"
        return one_line(f"inputs {listed(self.inputs)}{kinds}; outputs {listed(self.outputs)}", 400)


_FATAL = 4  # of onnxruntime's severities; errors come as exceptions, and are not to be printed as well


def open_net(path: str | Path, refuse: Callable[[str], SimgrabError] = DetectorError, threads: int = THREADS) -> Net:
    """Open an ONNX file.

    Parameters
    ----------
    refuse : callable
        Makes the error to raise from a message.
    threads : int
        Threads of onnxruntime.

    Raises
    ------
    SimgrabError
        Made by ``refuse``, if the file is missing or names other files, onnxruntime cannot load it, or an output has
        more than `MOST_NUMBERS` numbers.
    """
    path = Path(path)
    content = read_bytes(path, refuse, most_bytes=MOST_BYTES)
    onnx_parts.check(content, lambda problem: refuse(f"{path} {problem}"))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    # Threads that spin after a run take the cores from OpenCV's.
    options.add_session_config_entry("session.force_spinning_stop", "1")
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.log_severity_level = _FATAL
    _limit_memory()
    try:
        with within(MOST_SECONDS, lambda: options.set_load_cancellation_flag(True)):
            session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"], enable_fallback=False
            )
    except Exception as problem:  # its errors have no common base
        raise refuse(f"{path} is not an ONNX model that can be run ({_why(problem)})") from None
    metadata = {
        key: value
        for key, value in session.get_modelmeta().custom_metadata_map.items()
        if len(value) <= MOST_METADATA or key == KEY
    }
    inputs, outputs = (
        {one.name: tuple(s if isinstance(s, int) else None for s in one.shape or ()) for one in ends}
        for ends in (session.get_inputs(), session.get_outputs())
    )
    types = tuple(one.type for one in session.get_inputs())
    net = Net(path, session, inputs, outputs, types, _facts(path, metadata, refuse), metadata, refuse)
    for name, shape in outputs.items():
        if math.prod(side or 1 for side in shape) > MOST_NUMBERS:  # a free one counts as 1
            raise refuse(f"{path}: its output {one_line(name)} has more than {MOST_NUMBERS} numbers")
    return net


def _facts(path: Path, metadata: Mapping[str, str], refuse: Callable[[str], SimgrabError]) -> dict[str, Any]:
    text, what = metadata.get(KEY, "{}"), f"{path}: its metadata {KEY!r} was not written by simgrab"
    facts = parse_json(text, refuse, what) if len(text) <= MOST_METADATA else None
    if not isinstance(facts, dict):
        raise refuse(what)
    return facts


@functools.cache
def _limit_memory() -> None:
    """Let all nets of this process share one memory arena of limited size."""
    onnxruntime.set_default_logger_severity(_FATAL)
    about = onnxruntime.OrtMemoryInfo(
        "Cpu", onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, onnxruntime.OrtMemType.DEFAULT
    )
    with suppress(Exception):  # a program that uses simgrab may have given one of its own
        onnxruntime.create_and_register_allocator(about, onnxruntime.OrtArenaCfg({"max_mem": MOST_MEMORY}))


def _why(problem: Exception) -> str:
    text = str(problem)
    if "terminate flag" in text or "canceled" in text.lower():
        return f"it takes longer than {MOST_SECONDS:.0f} s"
    if isinstance(problem, MemoryError) or any(sign in text for sign in ("Available memory", "Failed to allocate")):
        return f"it takes more memory than there is, or than {MOST_MEMORY >> 30} GiB"
    return first_line(problem)
