"""The reader: LeNet-5 on the digits' cells. It refuses uncertain digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgrab.errors import ReaderError
from simgrab.instrument.net import open_net
from simgrab.instrument.read.crops import INPUT_PX, Crops, Picture, crops, fitted
from simgrab.io.parse import parse_json
from simgrab.io.resources import ASSETS
from simgrab.model.layouts import Layout
from simgrab.model.records.observations import Reading

READER_WEIGHTS = ASSETS / "weights" / "reader.onnx"
METADATA = "simgrab.reader"  # key of the ONNX metadata that holds the threshold
CLASSES = 11
NO_DIGIT = 10
DIGITS = np.array(list("0123456789?"))
HIGHEST_THRESHOLD = 0.999


class Reader:
    """Reads the display's rope lengths with a net in an ONNX file.

    The net is LeNet-5 (LeCun, Bottou, Bengio & Haffner, 1998, section II.B) with rectifiers, maxima for S2 and S4,
    every map of S2 feeding every one of C3, and a softmax over ten digits and "no digit". One net reads all cells
    without their position, so that it cannot learn which lengths are likely.

    Parameters
    ----------
    model : path
        File that `simgrab train reader` wrote.

    Attributes
    ----------
    threshold : float
        A digit with less confidence is refused; read from the file.

    Raises
    ------
    ReaderError
        If the file is not a reader.

    Examples
    --------
    >>> from simgrab import layouts
    >>> blank = np.zeros((1080, 1920, 3), np.uint8)
    >>> Reader().read(blank, layouts.load("two-by-four")).status
    'refused'
    """

    def __init__(self, model: str | Path = READER_WEIGHTS) -> None:
        self._net = open_net(model, ReaderError, threads=1)  # eight digits are too little work for more
        known = self._net.metadata.get(METADATA)
        inputs, outputs = (tuple(shape[1:] for shape in e.values()) for e in (self._net.inputs, self._net.outputs))
        floats = self._net.types == ("tensor(float)",)
        if known is None or not floats or inputs != ((1, INPUT_PX, INPUT_PX),) or outputs != ((CLASSES,),):
            raise ReaderError(f"{model} is not a digit reader ({self._net}); simgrab train reader writes one")
        try:
            self.threshold = float(parse_json(known, ReaderError, METADATA)["threshold"])
        except (ReaderError, ValueError, LookupError, TypeError, OverflowError):
            raise ReaderError(f"{model}: its metadata {METADATA!r} was not written by simgrab") from None
        if not 0 < self.threshold <= 1:
            raise ReaderError(f"{model}: its threshold must be more than 0 and 1 at most, got {self.threshold:g}")
        sums = self.probabilities(np.zeros((1, 1, INPUT_PX, INPUT_PX), np.float32)).sum(axis=1)
        if not np.allclose(sums, 1, atol=1e-3):
            raise ReaderError(f"{model} is not a digit reader: its probabilities do not add up to 1")

    def read(self, picture: Picture, layout: Layout) -> Reading:
        """Read the display in a picture.

        Parameters
        ----------
        picture : ndarray of uint8, shape (height, width, 3) or (height, width)
            RGB or grey.
        layout : Layout
            Where the digits are, e.g. a calibration's ``digit_layout``. It is scaled to a picture of another size with
            the same aspect ratio.

        Raises
        ------
        ReaderError, LayoutError
            If the array is not a picture, or the layout does not fit it.
        """
        layout = fitted(picture, layout)
        return reading(self.probabilities(crops(picture, layout)), layout, self.threshold)

    def probabilities(self, entered: Crops) -> Crops:
        """Probability of each digit and of "no digit", shape (n, 11), for crops of shape (n, 1, 32, 32)."""
        (result,) = self._net(entered)
        if result.shape != (len(entered), CLASSES):
            raise ReaderError(f"{self._net.path} outputs shape {result.shape}, not {(len(entered), CLASSES)}")
        return np.asarray(result, np.float32)


def reading(probabilities: Crops, layout: Layout, threshold: float) -> Reading:
    """Compose a reading from the probabilities, shape (8, 11), of a layout's cells.

    |OA| follows from the hoist rope alone: doubt about a digit of the closing rope does not refuse it.
    """
    best, confidence = probabilities.argmax(axis=1), probabilities.max(axis=1).astype(float)
    sure = (confidence >= threshold) & (confidence <= 1 + 1e-6)  # and a number
    doubtful = (best == NO_DIGIT) | ~sure
    hoist, closing = layout.written("".join(DIGITS[np.where(doubtful, NO_DIGIT, best)])).split()
    if doubtful[:4].any():
        reason = _why(best, confidence, doubtful, threshold)
        return Reading("refused", reason, hoist, closing, None)
    return Reading("read", "", hoist, closing, layout.length(hoist))


def _why(best: np.ndarray, confidence: np.ndarray, doubtful: np.ndarray, threshold: float) -> str:
    if (best == NO_DIGIT).all():
        return "no digits where the layout has the display"
    cells = [f"{'hoist' if i < 4 else 'closing'}.{i % 4}" for i in range(len(best))]
    i = int(np.flatnonzero(doubtful)[0])
    what = (
        "shows no digit"
        if best[i] == NO_DIGIT
        else f"may be a {best[i]}, at {confidence[i]:.2f} below the threshold of {threshold:.2f}"
    )
    more = int(doubtful.sum()) - 1
    return f"{cells[i]} {what}" + (f", and {more} more" if more else "")
