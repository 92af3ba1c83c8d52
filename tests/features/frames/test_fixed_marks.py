"""Marks that never move are found; what is passed, or a scene that stands still, is not."""

import cv2
import numpy as np

from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.frames.fixed_marks import FEWEST_PICTURES, FixedMarks
from tokt.features.frames.grid import Grid

GRID = Grid()


def fixed_patches(pictures, grid):
    marks = FixedMarks()
    for picture in pictures:
        marks.add(FramePictures(picture, GRID).rounded)
    return marks.patches(grid)


def frames(count, step_px, marked=True, width=640, structure=True, height=480):
    """A structure that goes through the picture, in noise, and a clock at the upper right."""
    rng = np.random.default_rng(2)
    wall = rng.normal(0, 20, (height // 8, width // 8 + 400)).repeat(8, 0).repeat(8, 1)
    for number in range(count):
        picture = rng.normal(60, 3, (height, width))
        if structure:
            at = int(number * step_px)
            picture[height // 3 :, : width // 2] += wall[
                : height - height // 3, at : at + width // 2
            ]
        picture = picture.clip(0, 255).astype(np.uint8)
        if marked:
            words, at = f"12:00:{number:02d}", (width - 170, 24)
            cv2.putText(picture, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)
        yield picture


def test_a_clock_is_found_and_what_is_passed_is_not():
    found = fixed_patches(frames(40, 5.0), GRID)
    assert found[0, 7:9].all() and not found[1:].any()
    assert not fixed_patches(frames(40, 5.0, marked=False), GRID).any()


def test_a_clock_in_open_water_is_found():
    found = fixed_patches(frames(40, 0.0, structure=False), GRID)
    assert found[0, 7:9].all() and not found[1:].any()


def test_nothing_is_said_of_few_pictures_or_of_a_scene_that_stands_still():
    assert not fixed_patches(frames(FEWEST_PICTURES - 1, 5.0), GRID).any()
    assert not fixed_patches(frames(40, 0.0), GRID).any()
    assert not fixed_patches([], GRID).any()


def test_pictures_of_another_size_begin_anew():
    many = [*frames(20, 5.0), *frames(FEWEST_PICTURES - 1, 5.0, height=400)]
    assert not fixed_patches(many, GRID).any()
