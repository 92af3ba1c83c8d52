"""USB cameras: FFmpeg's Video4Linux on a device that is a stand-in, in a process as in a run."""

import json
import sys

import cv2
import pytest

from tests.calls import run_python
from tests.waiting import until
from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.reason import Reason
from tokt.inference.sources.open import open_camera_source
from tokt.inference.sources.video.address import VideoAddress
from tokt.inference.sources.video.driver import open_drivers
from tokt.inference.sources.video.newest import NewestReading, StreamLostError
from tokt.inference.sources.video.v4l2 import read_v4l2

from .encoding import encode
from .pictures import bgr, number_of
from .v4l2_device import DAMAGED, GONE, HANGS, NO_TIME, WHOLE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Video4Linux")


def jpeg(number):
    return cv2.imencode(".jpg", bgr(number))[1].tobytes()


def yuyv(number):
    return cv2.cvtColor(bgr(number), cv2.COLOR_BGR2YUV_YUYV).tobytes()


def captures(url, enough):
    """What a driver delivers, until that is enough."""
    driver = open_drivers([VideoAddress.parse(url)], SYSTEM_CLOCK)[0]
    delivered = []
    driver.start(delivered.append)
    try:
        until(lambda: enough(delivered), lambda: [str(each.fault) for each in delivered[-3:]])
    finally:
        driver.stop()
    return delivered


def numbers(delivered):
    return [number_of(each.picture) for each in delivered if each.picture is not None]


@pytest.mark.parametrize("options", ["", "?format=yuyv", "?format=h264", "?size=320x240&rate=30"])
def test_a_camera_is_read_in_each_format(device, options):
    device.sends("MJPG", *((WHOLE, jpeg(number)) for number in range(30)))
    device.sends("YUYV", *((WHOLE, yuyv(number)) for number in range(30, 60)))
    film = encode("h264", range(60, 90), key_every=10)
    device.sends("H264", *((WHOLE, unit.data) for unit in film))
    delivered = captures(device.url(options), lambda got: len(numbers(got)) > 8)
    found = numbers(delivered)
    first = {"?format=yuyv": 30, "?format=h264": 60}.get(options, 0)
    assert set(found) <= set(range(first, first + 30))
    assert {each.picture.shape for each in delivered if each.picture is not None} == {(240, 320, 3)}
    ages = [each.arrived - each.taken_s for each in delivered if each.picture is not None]
    assert max(map(abs, ages)) < 1e-3, "a picture is as old as the driver says"


def test_without_mjpeg_it_is_yuyv(device):
    device.sends("YUYV", *((WHOLE, yuyv(number)) for number in range(30)))
    device.sends("H264", (WHOLE, b"never asked for"))
    assert numbers(captures(device.url(), lambda got: len(numbers(got)) > 3))


@pytest.mark.parametrize("name", ["MJPG", "YUYV", "H264"])
def test_a_buffer_that_the_driver_calls_damaged_is_no_picture(device, name):
    film = [unit.data for unit in encode("h264", 40, key_every=20)]
    made = {"MJPG": jpeg, "YUYV": yuyv, "H264": film.__getitem__}[name]
    device.sends(name, *((DAMAGED if n == 5 else WHOLE, made(n)) for n in range(40)))
    delivered = captures(
        device.url(f"?format={ {'MJPG': 'mjpeg'}.get(name, name.lower()) }"),
        lambda got: any(each.fault for each in got) and len(numbers(got)) > 8,
    )
    assert {each.fault.reason for each in delivered if each.fault} <= {
        Reason.INCOMPLETE,
        Reason.DAMAGED,
    }
    broken = set(range(5, 20)) if name == "H264" else {5}
    assert not broken & set(numbers(delivered))


def test_a_jpeg_of_which_a_part_is_missing_is_no_picture(device):
    cut = jpeg(1)[:5000] + jpeg(1)[6000:]
    device.sends("MJPG", (WHOLE, jpeg(0)), (WHOLE, cut))
    seen = captures(device.url(), lambda got: any(e.fault for e in got) and numbers(got))
    assert set(numbers(seen)) == {0}
    assert {each.fault.reason for each in seen if each.fault} == {Reason.INCOMPLETE}


def test_a_camera_that_is_pulled_out_is_lost_and_comes_back(device):
    buffers = [(WHOLE, jpeg(number)) for number in range(8)]
    device.sends("MJPG", *buffers[:4], (GONE, b""), *buffers[4:], (GONE, b""))
    delivered = captures(device.url(), lambda got: set(numbers(got)) >= {3, 4})
    assert all(each.fault.reason is Reason.CAMERA_LOST for each in delivered if each.fault)


def test_a_camera_that_stalls_is_lost(device):
    device.sends("MJPG", (WHOLE, jpeg(0)), (WHOLE, jpeg(1)), (HANGS, b""))
    delivered = captures(device.url(), lambda got: got and got[-1].fault)
    assert delivered[-1].fault.reason is Reason.CAMERA_LOST


def test_stamps_of_another_clock_are_not_believed(device):
    device.sends("MJPG", *((NO_TIME, jpeg(number)) for number in range(9)))
    delivered = captures(device.url(), lambda got: len(numbers(got)) > 3)
    assert all(SYSTEM_CLOCK.monotonic() - each.arrived < 120 for each in delivered)
    assert all(each.taken_s > 10 for each in delivered)


@pytest.mark.parametrize(
    ("options", "words"),
    [("?size=1280x720", "not 1280x720"), ("?format=h264", r"no h264 \(it has mjpeg\)")],
)
def test_what_a_camera_cannot_do_is_refused(device, options, words):
    device.sends("MJPG", *((WHOLE, jpeg(number)) for number in range(9)))
    wanted = SourceConfig(source=device.url(options))
    with pytest.raises(ToktError, match=words):
        open_camera_source(wanted, SYSTEM_CLOCK, print)


def test_a_camera_whose_formats_have_no_name_here_sends_its_own(device):
    device.sends("GREY", *((WHOLE, bgr(number)[:, :, 1].tobytes()) for number in range(9)))
    assert set(numbers(captures(device.url(), lambda got: len(numbers(got)) > 3))) <= set(range(9))


def test_what_is_no_camera_is_told(tmp_path):
    (tmp_path / "file").touch()
    for name, words in (("none", "No such file"), ("file", "Inappropriate ioctl")):
        with pytest.raises(StreamLostError, match=words):
            read_v4l2(VideoAddress.parse(f"v4l2:{tmp_path / name}"), NewestReading())


LISTS = """
import json, sys
from tokt.inference.sources.video.modes import describe_camera
print(json.dumps(describe_camera(sys.argv[1])))
"""


def test_what_a_camera_is_called_and_its_formats_are_listed(device):
    device.sends("MJPG", (WHOLE, jpeg(0)))
    device.sends("YUYV", (WHOLE, yuyv(0)))
    device.sends("GREY", (WHOLE, b""))
    told = run_python("-c", LISTS, device.path).stdout
    assert json.loads(told) == ["A camera: of tests", ["mjpeg", "yuyv", "GREY"]]
