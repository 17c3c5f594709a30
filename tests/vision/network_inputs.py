"""The inputs of the stored reference outputs, made from the drawn mannequin."""

import numpy as np
from mannequin import mannequin


def matting_picture():
    """What U^2-Net takes: 320 x 320 px, about zero mean, shape (1, 320, 320, 3)."""
    return ((_square(320) - 0.45) / 0.225).astype(np.float32)[None]


def landmark_picture():
    """What BlazePose takes: 256 x 256 px, 0 to 1, shape (1, 256, 256, 3)."""
    return _square(256).astype(np.float32)[None]


def _square(size):
    """The mannequin's nearest pixels on a square as wide as it is high."""
    image, *_ = mannequin()
    height, width = image.shape[:2]
    wide = np.empty((height, height, 3), np.uint8)
    wide[:] = image[0, 0]
    wide[:, (height - width) // 2 : (height + width) // 2] = image
    places = np.arange(size) * height // size
    return wide[places][:, places] / 255.0
