"""Opens ONNX files and runs them on two threads.

onnxruntime and not cv2.dnn: on one core find took 7.5 ms and refine 3.4 ms against 17 and 9 (OpenCV 5.0.0), and what
cv2.dnn said was off by up to 0.3 in refine. It also tells a file's shapes and metadata, by which others are refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from simgrab.errors import DetectorError, first_line

THREADS = 2
KEY = "simgrab"  # of the metadata in our own files


@dataclass(frozen=True, eq=False)
class Net:
    """An ONNX file that can be run.

    Attributes
    ----------
    path : Path
    inputs, outputs : dict of str to tuple
        Shapes by name; a free dimension is None.
    types : tuple of str
        Of the inputs, as onnxruntime names them.
    facts : dict
        What simgrab wrote into the file's metadata; empty in others.
    metadata : dict of str to str
        The file's, whoever wrote it.
    """

    path: Path
    session: onnxruntime.InferenceSession
    inputs: Mapping[str, tuple[int | None, ...]]
    outputs: Mapping[str, tuple[int | None, ...]]
    types: tuple[str, ...]
    facts: dict[str, Any]
    metadata: Mapping[str, str]

    def __call__(self, pictures: NDArray[np.generic]) -> list[NDArray[np.float32]]:
        """Run a batch, of the shape in `inputs`; returns the outputs in the order of `outputs`."""
        return list(self.session.run(None, {next(iter(self.inputs)): pictures}))

    def __str__(self) -> str:
        def listed(shapes: Mapping[str, tuple[int | None, ...]]) -> str:
            return ", ".join(f"{name} {' x '.join(str(s or '?') for s in shape)}" for name, shape in shapes.items())

        kinds = "" if set(self.types) == {"tensor(float)"} else f" of {', '.join(self.types)}"
        return f"inputs {listed(self.inputs)}{kinds}; outputs {listed(self.outputs)}"


def open_net(path: str | Path) -> Net:
    """Open an ONNX file.

    Raises
    ------
    DetectorError
        If there is none, or onnxruntime cannot load it.
    """
    path = Path(path)
    if not path.is_file():
        raise DetectorError(f"{path}: no such file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = THREADS, 1
    # Threads that spin between nets take the cores from OpenCV's.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3  # errors come as exceptions
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as problem:  # its errors have no common base
        raise DetectorError(f"{path} is no ONNX model that can be run ({first_line(problem)})") from None
    metadata = session.get_modelmeta().custom_metadata_map
    try:
        facts = json.loads(metadata.get(KEY, "{}"))
    except ValueError:
        facts = None
    if not isinstance(facts, dict):
        raise DetectorError(f"{path}: its metadata {KEY!r} is none that simgrab wrote")
    inputs, outputs = (
        {one.name: tuple(s if isinstance(s, int) else None for s in one.shape) for one in ends}
        for ends in (session.get_inputs(), session.get_outputs())
    )
    types = tuple(one.type for one in session.get_inputs())
    return Net(path, session, inputs, outputs, types, facts, metadata)
