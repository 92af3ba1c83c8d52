"""How colours look."""

import numpy as np


def linear(colours):
    """Linear light of sRGB colours from 0 to 255, of shape (..., 3), R first."""
    parts = np.asarray(colours, float) / 255
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)


def luminance(colours):
    """Of sRGB colours as `linear` takes them."""
    return linear(colours) @ (0.2126, 0.7152, 0.0722)


def contrast(one, other):
    return (np.maximum(one, other) + 0.05) / (np.minimum(one, other) + 0.05)
