"""Random changes of whole frames: what another camera, water, light or distance does to one.

A model that learns from changed frames beside those that the camera gave carries over to waters it
never saw. A change is drawn from a generator of random numbers, so that the same seed gives the
same frame. It is made of the frame at width `WIDTH`, and has a patch of the frame as it was for
every patch of its own: that patch's label holds for it.

The image formation that tint, haze and light follow is that of Jaffe (1990), "Computer modeling and
the design of optimal underwater imaging systems", IEEE J. Oceanic Eng. 15(2): direct light that
falls with the range, and veiling light that grows with it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tokt.features.common.arrays import F32, I64, U8, Bools

WIDTH = 720
"""Pixels: wide enough for the finest structure that extractors look at in frames of width 360."""

_GRAY_CHANCE = 0.08
_ZOOM_TRIES = 40
_FULL = 0.75  # part of a cut-out's patches that are obstacles where it stands for a filled view


@dataclass(frozen=True)
class ChangedFrame:
    """A changed frame, and where its patches come from."""

    frame: U8  # (height, width, 3)
    source: I64  # (n_patches,): the patch of the unchanged frame whose label holds; -1 for none


def at_width(frame: U8) -> U8:
    """A frame as BGR and `WIDTH` pixels wide."""
    if frame.ndim == 2:
        frame = np.asarray(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), np.uint8)
    size = WIDTH, max(1, round(frame.shape[0] * WIDTH / frame.shape[1]))
    shrinks = frame.shape[1] > WIDTH
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(frame, size, interpolation=how), np.uint8)


def changed(frame: U8, obstacle: Bools, known: Bools, rng: np.random.Generator) -> ChangedFrame:
    """Change a frame at random.

    Parameters
    ----------
    frame : array of uint8, shape (height, `WIDTH`, 3)
    obstacle, known : array of bool, shape (rows, cols)
        Which of the frame's patches are labelled as obstacles, and which have a label.
    rng : numpy.random.Generator
    """
    cells = np.arange(obstacle.size).reshape(obstacle.shape)
    kind = rng.random()
    if kind < 0.45:  # zoomed: a quarter into any part, a tenth each into obstacles and into water
        what = "any" if kind < 0.25 else "full" if kind < 0.35 else "water"
        cut = _zoomed(frame, obstacle, known, what, rng)
        if cut is not None:
            frame, cells = cut
    light = frame.astype(np.float32)
    for chance, change in _CHANGES:
        if rng.random() < chance:
            light = change(light, rng)
    if rng.random() < _GRAY_CHANCE:
        light = np.asarray(
            cv2.cvtColor(cv2.cvtColor(light, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), np.float32
        )
    out = np.ascontiguousarray(np.clip(light, 0, 255).astype(np.uint8))
    return ChangedFrame(out, np.asarray(cells.ravel(), np.int64))


def _zoomed(
    frame: U8, obstacle: Bools, known: Bools, what: str, rng: np.random.Generator
) -> tuple[U8, I64] | None:
    """Some of the frame's patches as a whole frame: any, all obstacles or all water."""
    rows, cols = obstacle.shape
    for _ in range(_ZOOM_TRIES):
        part = rng.uniform(0.6, 0.95, 2) if what == "any" else np.repeat(rng.uniform(0.3, 0.65), 2)
        tall, wide = np.maximum(1, np.rint(part * (rows, cols))).astype(int)
        row, col = rng.integers(0, rows - tall + 1), rng.integers(0, cols - wide + 1)
        block = np.s_[row : row + tall, col : col + wide]
        solid = obstacle[block] & known[block]
        if what == "full" and (solid.mean() < _FULL or (known[block] & ~obstacle[block]).any()):
            continue
        if what == "water" and not (known[block] & ~obstacle[block]).all():
            continue
        height, width = frame.shape[:2]
        top, bottom = height * row // rows, height * (row + tall) // rows
        left, right = width * col // cols, width * (col + wide) // cols
        down = row + ((np.arange(rows) + 0.5) * tall / rows).astype(int)
        across = col + ((np.arange(cols) + 0.5) * wide / cols).astype(int)
        cells = down[:, None] * cols + across
        if what != "full" and max(tall / rows, wide / cols) < 0.75:
            # A part of a patch that has an obstacle may be water, unless all around are obstacles.
            around = cv2.erode((obstacle | ~known).astype(np.uint8), np.ones((3, 3))) > 0
            cells = np.where((obstacle & ~around).ravel()[cells], -1, cells)
        return at_width(frame[top:bottom, left:right]), np.asarray(cells, np.int64)
    return None


def _field(rng: np.random.Generator, height: int, width: int) -> F32:
    """A smooth random field of about unit variance."""
    coarse = rng.normal(0, 1, (3, 3)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))


def _tint(light: F32, rng: np.random.Generator) -> F32:
    """Another tone curve, white balance and exposure."""
    curve = (light / 255) ** rng.uniform(0.65, 1.5)
    gains = np.exp(rng.normal(0, 0.22, 3) + rng.normal(0, 0.25)).astype(np.float32)
    return np.asarray(255 * curve * gains, np.float32)


def _haze(light: F32, rng: np.random.Generator) -> F32:
    """Veiling light and attenuation that grow with an imagined range."""
    veil = light.reshape(-1, 3).mean(axis=0) * np.exp(rng.normal(0, 0.3, 3)) + rng.uniform(0, 40)
    field = _field(rng, *light.shape[:2])[..., None]
    passed = np.clip(rng.uniform(0.4, 0.95) + 0.15 * field, 0.25, 1).astype(np.float32)
    return np.asarray(light * passed + veil.astype(np.float32) * (1 - passed), np.float32)


def _shade(light: F32, rng: np.random.Generator) -> F32:
    """A lamp's fall-off or light from one side, and a tint that drifts over the frame."""
    height, width = light.shape[:2]
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, width, dtype=np.float32)[None]
    if rng.random() < 0.5:
        shade = 1 - rng.uniform(0, 0.6) * (x * x + y * y) / 2
    else:
        shade = 1 + rng.uniform(-0.4, 0.4) * x + rng.uniform(-0.4, 0.4) * y
    drift = np.stack([_field(rng, height, width) for _ in range(3)], axis=-1)
    return np.asarray(
        light * np.clip(shade, 0.15, 2)[..., None] * np.exp(rng.uniform(0.05, 0.3) * drift)
    )


def _soft(light: F32, rng: np.random.Generator) -> F32:
    """Focus that is somewhat off."""
    return np.asarray(cv2.GaussianBlur(light, (0, 0), rng.uniform(0.5, 2.2)))


def _noise(light: F32, rng: np.random.Generator) -> F32:
    """A sensor's noise, of single pixels or smeared as a mosaic or denoising leaves it."""
    spread = np.exp(rng.uniform(np.log(0.6), np.log(7)))
    both = rng.normal(0, spread, (*light.shape[:2], 1)) + rng.normal(0, spread / 2, light.shape)
    noise = both.astype(np.float32)
    if rng.random() < 0.5:  # of photons: by the root of the level, as it is at level 100
        noise *= np.sqrt(np.clip(light.mean(axis=2, keepdims=True), 1, 255) / 100)
    if rng.random() < 0.5:
        noise = np.float32(1.8) * cv2.GaussianBlur(noise, (0, 0), rng.uniform(0.5, 1.2))
    return np.asarray(light + noise, np.float32)


def _border(light: F32, rng: np.random.Generator) -> F32:
    """Dark or soft edges, as grabbers and recordings leave them."""
    out, level = light.copy(), rng.uniform(0, 40)
    for side in rng.permutation(4)[: rng.integers(1, 5)]:
        pixels = int(np.exp(rng.uniform(0, np.log(14))))
        soft = rng.random() < 0.5
        keep = np.linspace(rng.uniform(0, 0.7), 1, pixels) if soft else np.zeros(pixels)
        view = out if side < 2 else out.transpose(1, 0, 2)
        view = view if side % 2 == 0 else view[::-1]
        weight = keep[: len(view), None, None].astype(np.float32)
        view[:pixels] = view[:pixels] * weight + level * (1 - weight)
    return out


def _codec(light: F32, rng: np.random.Generator) -> F32:
    """A smaller stream, enlarged again, and lossy compression."""
    frame = np.clip(light, 0, 255).astype(np.uint8)
    height, width = frame.shape[:2]
    if rng.random() < 0.5:
        part = rng.uniform(0.35, 0.8)
        small = cv2.resize(frame, None, fx=part, fy=part, interpolation=cv2.INTER_AREA)
        frame = np.asarray(cv2.resize(small, (width, height)), np.uint8)
    if rng.random() < 0.7:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.uniform(18, 75))]
        frame = np.asarray(cv2.imdecode(cv2.imencode(".jpg", frame, quality)[1], 1), np.uint8)
    return frame.astype(np.float32)


def _rim(light: F32, rng: np.random.Generator) -> F32:
    """The dark rim of a port or of a fisheye lens."""
    height, width = light.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    middle_x, middle_y = rng.uniform(0.35, 0.65, 2) * (width, height)
    radius = np.hypot(x - middle_x, y - middle_y) / np.hypot(width / 2, height / 2)
    passed = np.clip((rng.uniform(0.75, 1.05) - radius) / rng.uniform(0.01, 0.2), 0, 1)[..., None]
    return np.asarray(light * passed + rng.uniform(0, 40) * (1 - passed), np.float32)


_CHANGES = (
    (0.7, _tint),
    (0.4, _haze),
    (0.5, _shade),
    (0.3, _soft),
    (0.5, _noise),
    (0.2, _border),
    (0.1, _rim),
    (0.5, _codec),
)
