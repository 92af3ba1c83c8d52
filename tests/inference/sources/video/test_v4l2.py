"""USB cameras: FFmpeg's Video4Linux on a device that is a stand-in, in a process as in a run."""

import json
import sys

import cv2
import pytest

from tests.calls import run_python
from tests.waiting import until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import Reason
from tokt.inference.sources.video.address import VideoAddress
from tokt.inference.sources.video.driver import open_drivers
from tokt.inference.sources.video.newest import NewestReading, StreamLostError
from tokt.inference.sources.video.v4l2 import read_v4l2

from .encoding import encode
from .pictures import bgr, jpeg, number_of
from .v4l2_device import DAMAGED, GONE, HANGS, NO_TIME, WHOLE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Video4Linux")


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


@pytest.mark.parametrize("options", ["?format=yuyv", "?format=h264", "?size=320x240&rate=30"])
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


@pytest.mark.parametrize(
    ("name", "picture"), [("YUYV", yuyv), ("GREY", lambda number: bgr(number)[:, :, 1].tobytes())]
)
def test_without_mjpeg_it_is_yuyv_or_the_camera_s_own(device, name, picture):
    device.sends(name, *((WHOLE, picture(number)) for number in range(9)))
    if name == "YUYV":
        device.sends("H264", (WHOLE, b"never asked for"))
    assert set(numbers(captures(device.url(), lambda got: len(numbers(got)) > 3))) <= set(range(9))


@pytest.mark.parametrize("name", ["MJPG", "YUYV", "H264"])
def test_what_is_damaged_or_of_which_a_part_is_missing_is_no_picture(device, name):
    film = [unit.data for unit in encode("h264", 40, key_every=20)]
    made = {"MJPG": jpeg, "YUYV": yuyv, "H264": film.__getitem__}[name]
    buffers = [(DAMAGED if n == 5 else WHOLE, made(n)) for n in range(40)]
    if name == "MJPG":  # which the driver does not know
        buffers[7] = WHOLE, jpeg(7)[:5000] + jpeg(7)[6000:]
    device.sends(name, *buffers)
    delivered = captures(
        device.url(f"?format={ {'MJPG': 'mjpeg'}.get(name, name.lower()) }"),
        lambda got: any(each.fault for each in got) and len(set(numbers(got))) > 8,
    )
    assert {each.fault.reason for each in delivered if each.fault} <= {
        Reason.INCOMPLETE,
        Reason.DAMAGED,
    }
    broken = {"MJPG": {5, 7}, "YUYV": {5}, "H264": set(range(5, 20))}[name]
    assert not broken & set(numbers(delivered))


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


def test_what_is_no_camera_is_told(tmp_path):
    (tmp_path / "file").touch()
    for name, words in (("none", "No such file"), ("file", "Inappropriate ioctl")):
        with pytest.raises(StreamLostError, match=words):
            read_v4l2(VideoAddress.parse(f"v4l2:{tmp_path / name}"), NewestReading())


ASKS = """
import json, sys
from tokt.inference.sources.video.address import VideoAddress
from tokt.inference.sources.video.modes import describe_camera
from tokt.inference.sources.video.newest import NewestReading, StreamLostError
from tokt.inference.sources.video.v4l2 import read_v4l2
print(json.dumps(describe_camera(sys.argv[1])))
for options in sys.argv[2:]:
    try:
        read_v4l2(VideoAddress.parse(f"v4l2:{sys.argv[1]}{options}"), NewestReading())
    except StreamLostError as error:
        print(error)
"""


def test_what_a_camera_is_called_its_formats_and_what_it_cannot_do_are_told(device):
    device.sends("MJPG", (WHOLE, jpeg(0)))
    device.sends("YUYV", (WHOLE, yuyv(0)))
    device.sends("GREY", (WHOLE, b""))
    told = run_python("-c", ASKS, device.path, "?size=1280x720", "?format=h264").stdout
    described, size, form = told.splitlines()
    assert json.loads(described) == ["A camera: of tests", ["mjpeg", "yuyv", "GREY"]]
    assert "not 1280x720" in size and "no h264 (it has mjpeg" in form
