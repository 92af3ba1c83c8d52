"""Camera options and the names of cameras: what cannot be meant is refused in one line."""

import math

import pytest

from tests.calls import refuses
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.sources.open import open_camera_source


@pytest.mark.parametrize(
    ("options", "words"),
    [
        *[({"exposure_us": value}, "microseconds") for value in (0, math.nan)],
        *[({"camera_rate": value}, "frames per second") for value in (-1, math.inf)],
        ({"bandwidth": 0}, "bytes per second"),
        ({"gain_db": math.inf}, "dB"),
        ({"pixel_format": "BGR16"}, "choose from Mono8"),
        ({"packet_size": 64}, "500 to 16384"),
        ({"trigger": "Line 1"}, "'Line 1'"),
        ({"trigger": "Line1", "camera_rate": 10}, "a trigger or a frame rate"),
    ],
)
def test_what_cannot_be_meant(options, words):
    refuses(words, open_camera_source, SourceConfig("pymba:0", **options), SYSTEM_CLOCK, print)


@pytest.mark.parametrize(
    "text", ["pymba:", "pymba:1,", "pymba:1,2,3", "vimbax:1,", "genicam:", "usb:1"]
)
def test_what_names_no_cameras(text):
    refuses("live cameras are", open_camera_source, SourceConfig(text), SYSTEM_CLOCK, print)


def test_one_camera_is_not_two():
    both = SourceConfig("pymba:02-2130A, 02-2130A")
    refuses("are both '02-2130A'", open_camera_source, both, SYSTEM_CLOCK, print)
