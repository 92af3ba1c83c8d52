"""Camera options and the names of cameras: what cannot be meant is refused in one line."""

import math

import pytest

from tests.calls import refuses
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.capture import bandwidth_bytes_s
from tokt.inference.sources.open import check_camera_options, is_camera_source, open_camera_source


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


def test_what_can_be_meant():
    options = SourceConfig(
        exposure_us=5000, gain_db=-3, pixel_format="BayerRG8", packet_size=9000, trigger="Line1"
    )
    check_camera_options(options)
    assert bandwidth_bytes_s(options) == 115_000_000


@pytest.mark.parametrize(
    "text", ["pymba:", "pymba:1,", "pymba:1,2,3", "vimbax:1,", "genicam:", "usb:1"]
)
def test_what_names_no_cameras(text):
    refuses("live cameras are", open_camera_source, SourceConfig(text), SYSTEM_CLOCK, print)


def test_one_camera_is_not_two():
    both = SourceConfig("pymba:02-2130A, 02-2130A")
    refuses("are both '02-2130A'", open_camera_source, both, SYSTEM_CLOCK, print)


def test_cameras_and_folders_are_told_apart():
    assert is_camera_source("pymba:0") and is_camera_source("genicam:x,y")
    assert is_camera_source("vimbax:0")
    assert not is_camera_source("pymba") and not is_camera_source("dives/pymba:0")
