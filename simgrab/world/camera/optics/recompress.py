"""The artefacts of having been coded once: what a still taken out of a stream looks like.

JPEG stands in for the stream's key frames. Both quantise a block transform, so blocks, ringing and coarse chroma look
alike; H.264's deblocking and what it carries over from frame to frame are not here. A clip's are in its video.
"""

from __future__ import annotations

import cv2
import numpy as np

from simgrab.world.camera.optics.light import Picture


def recompress(rgb: Picture, quality: int) -> Picture:
    """Code and decode a finished picture, display included.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (height, width, 3)
    quality : int
        JPEG quality 1 … 100 with chroma at half the resolution; 0 leaves the picture alone.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
    """
    if quality == 0:
        return rgb
    _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))
