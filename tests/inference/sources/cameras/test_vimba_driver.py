"""One camera through the real pymba: what is set, what is delivered, and every way it can fail."""

import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.calls import refuses
from tests.waiting import MAX_S, until
from tokt.features.frames.camera_frame import frame_from_camera
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.reason import Reason
from tokt.inference.sources.cameras.capture import CameraDriver, Deliver
from tokt.inference.sources.cameras.vimba.driver import open_drivers

from .simulated_rig import HEIGHT, LEFT_ID, RATE_HZ, RIGHT_ID, WIDTH, pattern, seen

BYTES = {"Mono8": 1, "BGR8": 3, "RGB8": 3, "BayerRG8": 1, "BayerGB8": 1}


MADE: list[CameraDriver] = []


@pytest.fixture(autouse=True)
def stopped(simulator):
    """Whatever a test leaves running is stopped: its thread would call a Python that has ended."""
    yield
    while MADE:
        MADE.pop().stop()


def drivers(*names: str, **options: object) -> Sequence[CameraDriver]:
    made = open_drivers(names, SourceConfig(**options), SYSTEM_CLOCK)  # type: ignore[arg-type]
    MADE.extend(made)
    return made


def driver(name: str = "0", **options: object) -> CameraDriver:
    return drivers(name, **options)[0]


def started(one: CameraDriver, deliver: Deliver) -> CameraDriver:
    one.start(deliver)
    return one


@pytest.mark.parametrize("pixel_format", BYTES)
def test_pictures_are_the_cameras_bit_for_bit(pixel_format, simulator, delivered):
    simulator.set(-1, rate=200)
    one = started(driver(pixel_format=pixel_format), delivered)
    captures = delivered.wait(12)  # more than there are buffers
    one.stop()
    for capture in captures:
        moment = round(capture.taken_s * 200)
        raw = pattern(0, moment, WIDTH * HEIGHT * BYTES[pixel_format])
        expected = frame_from_camera(raw, HEIGHT, WIDTH, pixel_format)
        assert np.array_equal(capture.picture, expected) and not capture.fault
        assert capture.picture.flags.owndata
    steps = np.diff([capture.frame_id for capture in captures])
    assert steps.min() >= 1


def test_a_usb_camera_with_other_names_for_its_features(simulator, delivered):
    simulator.set(0, usb=1)
    one = driver(exposure_us=700, camera_rate=40, pixel_format="BGR8Packed")
    started(one, delivered)
    (capture, *_) = delivered.wait(1)
    assert capture.picture.shape == (HEIGHT, WIDTH, 3)
    assert one.period_s == 1 / 40
    assert simulator.feature(0, "ExposureTime") == 700
    assert simulator.feature(0, "AcquisitionFrameRateEnable") == 1
    one.stop()
    # Left alone it sends what tokt does not read: the first that it does is chosen.
    one = started(driver(), delivered)
    assert delivered.wait(len(delivered.captures) + 1)[-1].picture.shape == (HEIGHT, WIDTH, 3)
    one.stop()


def test_what_was_asked_for_is_set(simulator, delivered):
    one = driver(exposure_us=1234.5, gain_db=6, packet_size=4000, camera_rate=25, ptp=True)
    assert one.period_s is None and not one.shared_clock
    started(one, delivered)
    wanted = {"ExposureTimeAbs": 1234.5, "Gain": 6, "GVSPPacketSize": 4000}
    for name, value in {**wanted, "AcquisitionFrameRateAbs": 25}.items():
        assert simulator.feature(0, name) == value
    assert one.period_s == 1 / 25 and one.shared_clock


def test_left_alone_the_packet_size_is_fitted_to_the_network(simulator, delivered):
    started(driver(), delivered)
    assert simulator.feature(0, "GVSPPacketSize") == 1500
    assert simulator.feature(0, "ExposureTimeAbs") == 15000
    assert simulator.feature(0, "StreamBytesPerSecond") == 115_000_000


def test_two_cameras_share_the_bandwidth(simulator, delivered):
    both = [started(one, delivered) for one in drivers("0", "1", bandwidth=80e6)]
    shares = [simulator.feature(camera, "StreamBytesPerSecond") for camera in (0, 1)]
    assert shares == [40e6, 40e6]
    for one in both:
        one.stop()
    # More than a camera can send is what it can.
    started(driver(bandwidth=1e9), delivered)
    assert simulator.feature(0, "StreamBytesPerSecond") == 124e6


@pytest.mark.parametrize(
    "name", ["1", RIGHT_ID, "02-2130A-06002", "169.254.1.2", "00:0F:31:00:00:02", "000F31000002"]
)
def test_all_the_ways_to_name_a_camera(name, simulator, delivered):
    started(driver(name, pixel_format="Mono8"), delivered)
    assert seen(delivered.wait(1)[0].picture)[0] == 1


def test_an_unknown_camera_is_answered_with_those_found(simulator, delivered):
    words = refuses("", driver("DEV_1").start, delivered)
    assert "'DEV_1'" in words and LEFT_ID in words and RIGHT_ID in words and "GC1380C" in words
    simulator.set(-1, cameras=0)
    refuses("found: none", driver("2").start, delivered)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exposure_us": 1e9}, r"refuses ExposureTimeAbs = 1000000000.0 \(it has 10"),
        ({"trigger": "Line9"}, r"refuses TriggerSource = Line9 \(it has Freerun, Line1"),
        ({"packet_size": 16000}, "refuses GVSPPacketSize"),
    ],
)
def test_what_a_camera_refuses(options, words, simulator, delivered):
    refuses(words, driver(**options).start, delivered)


def test_what_a_camera_does_not_have(simulator, delivered):
    simulator.set(0, usb=1)
    refuses("no GVSPPacketSize or GevSCPSPacketSize", driver(packet_size=1500).start, delivered)
    refuses("no PtpMode", driver(ptp=True).start, delivered)
    refuses("no pixel format Mono8: it has Mono12p", driver(pixel_format="Mono8").start, delivered)


def test_a_camera_in_use(simulator, delivered):
    started(driver(), delivered)
    refuses("in use by another program", driver().start, delivered)


def test_a_delivered_picture_never_changes(simulator, delivered):
    """The simulator scribbles over a buffer as soon as it is queued again."""
    simulator.set(-1, rate=500)
    one = started(driver(pixel_format="Mono8"), delivered)
    captures = delivered.wait(60)
    one.stop()
    assert [seen(capture.picture)[0] for capture in captures] == [0] * len(captures)
    assert len({seen(capture.picture)[1] for capture in captures}) == len(captures)


def test_incomplete_frames_have_no_picture(simulator, delivered):
    simulator.set(0, incomplete_every=3)
    started(driver(pixel_format="Mono8"), delivered)
    for capture in delivered.wait(9):
        moment = round(capture.taken_s * RATE_HZ)
        if moment % 3:
            assert seen(capture.picture) == (0, moment)
        else:
            assert capture.picture is None and capture.fault.reason is Reason.INCOMPLETE


def test_a_format_that_is_not_known_is_no_picture(simulator, delivered):
    """A camera may be told to send another one by somebody else while it streams."""
    one = started(driver(pixel_format="Mono8"), delivered)
    one._stream._camera.feature("PixelFormat").value = "YUV422Packed"  # type: ignore[attr-defined]
    before = len(delivered.captures)
    capture = delivered.wait(before + 4)[-1]
    one.stop()
    assert capture.picture is None and capture.fault.reason is Reason.DAMAGED
    assert "0x0210001f" in capture.fault


def test_what_deliver_raises_costs_one_capture_and_no_buffer(simulator, capfd):
    """pymba's own streaming would stop after as many as there are buffers."""
    simulator.set(-1, rate=200)
    reached = threading.Event()
    calls = []

    def deliver(capture):
        calls.append(threading.get_ident())
        if len(calls) == 40:
            reached.set()
        raise ValueError("a mistake")

    one = started(driver(), deliver)
    assert reached.wait(MAX_S)
    one.stop()
    assert one.failures == len(calls) >= 40
    assert threading.get_ident() not in calls and len(set(calls)) == 1
    assert capfd.readouterr().err == ""


def test_stop_joins_and_nothing_is_delivered_after_it(simulator, delivered):
    simulator.set(-1, rate=1000)
    one = driver(pixel_format="Mono8")
    for _ in range(10):
        before = len(delivered.captures)
        one.start(delivered)
        delivered.wait(before + 3)
        one.stop()
        after = len(delivered.captures)
        one.stop()
        assert [simulator.count(0, name) for name in ("opened", "announced", "queued")] == [0] * 3
        time.sleep(0.005)
        assert len(delivered.captures) == after


@pytest.mark.parametrize("manner", ["plain", "unnoticed", "handle_dies"])
def test_a_camera_pulled_out_is_closed_and_started_again(manner, simulator, delivered):
    if manner != "plain":
        simulator.set(0, **{manner: 1})
    one = started(driver("0", pixel_format="Mono8", exposure_us=500), delivered)
    delivered.wait(2)
    assert one.lost() == ""
    simulator.set(0, plugged=0)
    assert (one.lost() == "") == (manner == "unnoticed")
    one.stop()
    refuses("", one.start, delivered)
    simulator.set(0, plugged=1)
    assert simulator.feature(0, "ExposureTimeAbs") == 15000  # it has forgotten
    before = len(delivered.captures)
    one.start(delivered)
    assert seen(delivered.wait(before + 2)[-1].picture)[0] == 0
    assert simulator.feature(0, "ExposureTimeAbs") == 500
    one.stop()


def test_buffers_that_the_library_keeps_are_not_kept_for_ever(simulator, delivered):
    simulator.set(0, handle_dies=1)
    one = driver(pixel_format="Mono8")
    kept = []
    for _ in range(6):
        one.start(delivered)
        kept.append(one._stream)  # type: ignore[attr-defined]
        delivered.wait(len(delivered.captures) + 1)
        simulator.set(0, plugged=0)
        one.stop()
        simulator.set(0, plugged=1)
    assert [bool(stream._frames) for stream in kept] == [False] * 2 + [True] * 4


def test_an_index_stays_with_the_camera_it_meant(simulator, delivered):
    """With the first camera pulled out the second is the first of the list."""
    one = started(driver("0"), delivered)
    simulator.set(0, plugged=0)
    one.stop()
    refuses(LEFT_ID, one.start, delivered)


def resident_kb() -> int:
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0])


def test_thousands_of_frames_leave_no_memory_behind(simulator):
    """The 3000 frames are 27 MB: what stays of them is less than a tenth of that."""
    simulator.set(-1, rate=5000)
    count, sizes = 0, []

    def deliver(capture):
        nonlocal count
        count += 1
        if count in (500, 3500):
            sizes.append(resident_kb())

    started(driver(pixel_format="BGR8"), deliver)
    until(lambda: len(sizes) == 2)
    assert sizes[1] - sizes[0] < 2700
