"""Small videos and pictures, drawn here and now."""

from fractions import Fraction

import av
import numpy as np

SIZE = (64, 36)


def picture(i, size=SIZE):
    """A grey that says which picture it is, on a lighter left half."""
    width, height = size
    rgb = np.full((height, width, 3), 40 + 5 * (i % 30), np.uint8)
    rgb[:, : width // 2] += 20
    return rgb


def film(path, times, size=SIZE, options=None, draw=picture, coding=None, state=None, mark=None):
    """Write a picture at each time; the container follows from the name.

    ``coding`` are more options of the coder; ``state`` is called with the stream, and ``mark`` with each frame, to
    state more of them.
    """
    with av.open(str(path), "w", options=options or {}) as file:
        stream = file.add_stream("libx264", rate=9, options={"tune": "zerolatency", "g": "5"} | (coding or {}))
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        if state is not None:
            state(stream)
        stream.time_base = stream.codec_context.time_base = Fraction(1, 9000)
        for i, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(draw(i, size), format="rgb24")
            if mark is not None:
                frame = mark(frame)
            frame.pts, frame.time_base = round(time * 9000), Fraction(1, 9000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path
