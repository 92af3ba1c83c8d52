"""A buffer's picture. Buffers here are stand-ins with a buffer's attributes: viky, the simulated
camera, has neither padding nor parts nor time stamps, and never sends half a frame."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.inference.reason import NO_FAULT, Reason
from tokt.inference.sources.cameras.genicam.camera import pixels_of, taken_s

gentl = pytest.importorskip("genicam.gentl")

MONO, BGR, MONO12 = 1, 2, 3
NAMES = {MONO: "Mono8", BGR: "BGR8", MONO12: "Mono12Packed"}


def buffer(raw: bytes, height: int, width: int, **more: Any) -> SimpleNamespace:
    more = {"pixel_format": MONO, **more}
    return SimpleNamespace(raw_buffer=raw, height=height, width=width, **more)


def pixels(buffer: Any) -> Any:
    found, fault = pixels_of(buffer, NAMES.__getitem__)
    assert fault == NO_FAULT
    return found


@given(
    *(st.integers(1, 7), st.integers(1, 7), st.sampled_from([(MONO, 1), (BGR, 3)])),
    *(st.integers(0, 5), st.integers(0, 9), st.booleans()),
)
def test_padding_and_offset_are_left_out(height, width, kind, padding, offset, whole):
    pixel_format, depth = kind
    rows = np.random.default_rng(0).integers(0, 255, (height, width * depth + padding), np.uint8)
    raw = bytes(offset) + rows.tobytes()[: None if whole or not padding else -padding]
    placed = {"padding_x": padding, "image_offset": offset, "delivered_image_height": height}
    more = {"pixel_format": pixel_format, "size_filled": len(raw), **placed}
    found = pixels(buffer(raw, height, width, **more))
    assert (found.height, found.width, found.pixel_format) == (height, width, NAMES[pixel_format])
    assert found.data.tobytes() == rows[:, : width * depth].tobytes()


def test_the_first_image_of_several_parts():
    raw = bytes(10) + bytes(range(6)) + bytes(4)
    depth = SimpleNamespace(data_type=5, data_offset=0)
    size = {"width": 3, "height": 2, "x_padding": 0}
    image = SimpleNamespace(data_type=1, data_offset=10, data_format=MONO, **size)
    found = pixels(buffer(raw, 0, 0, parts=(depth, image), size_filled=20))
    assert (found.height, found.width, found.data.tobytes()) == (2, 3, bytes(range(6)))


@pytest.mark.parametrize(
    ("more", "reason", "words"),
    [
        ({"size_filled": 11}, Reason.INCOMPLETE, "11 of 12 bytes"),
        ({"size_filled": 0}, Reason.INCOMPLETE, "0 of 12 bytes"),
        ({"delivered_image_height": 2}, Reason.INCOMPLETE, "2 of 3 rows"),
        ({"pixel_format": MONO12}, Reason.UNREADABLE, "sends Mono12Packed pixels"),
    ],
)
def test_what_cannot_be_used_says_why(more, reason, words):
    found, fault = pixels_of(buffer(bytes(12), 3, 4, **more), NAMES.__getitem__)
    assert found is None and words in fault
    assert fault.reason is reason


class Silent:
    """A buffer whose producer does not say when it was taken, or says it in ticks only."""

    def __init__(self, error: type[Exception], ticks: int | None = None) -> None:
        self._error, self._ticks = error, ticks

    @property
    def timestamp_ns(self) -> int:
        raise self._error

    @property
    def timestamp(self) -> int:
        if self._ticks is None:
            raise self._error
        return self._ticks


def test_when_it_was_taken():
    unsaid = gentl.NotAvailableException
    assert taken_s(SimpleNamespace(timestamp_ns=2_500_000_000), None) == 2.5
    assert taken_s(Silent(unsaid, 36_858_975), 36_858_974.5) == pytest.approx(1.0)
    assert taken_s(Silent(unsaid, 36_858_975), None) is None
    assert taken_s(Silent(unsaid), 1e9) is None
    assert taken_s(SimpleNamespace(timestamp_ns=0, timestamp=0), 1e9) is None


def test_a_camera_that_is_gone_is_not_one_that_says_nothing():
    with pytest.raises(gentl.InvalidHandleException):
        taken_s(Silent(gentl.InvalidHandleException), 1e9)
