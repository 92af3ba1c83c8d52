"""harvesters and its simulated camera (viky.cti of the genicam package), in this process."""

import io
import json
import os
import shutil
import signal
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.calls import refuses
from tests.waiting import until
from tokt.features.frames.camera_frame import frame_from_camera
from tokt.inference.config import SourceConfig
from tokt.inference.reason import NO_FAULT, Reason
from tokt.inference.sources.cameras.genicam import producers as genicam_producers
from tokt.inference.sources.cameras.genicam.camera import FetchedFrame, GenicamCamera, opened_camera
from tokt.inference.sources.cameras.genicam.process import _chosen, _send_next
from tokt.inference.sources.cameras.genicam.producers import (
    ListedCamera,
    Listing,
    Place,
    Producers,
    opened_producers,
    producer_files,
)

genicam = pytest.importorskip("genicam")
pytest.importorskip("harvesters")

PRODUCERS = Path(genicam.__file__).parent
VARIABLE = "GENICAM_GENTL64_PATH"


@pytest.fixture(autouse=True)
def viky(monkeypatch):
    """The variable set; and what harvesters makes of Ctrl-C undone, as it is in this process."""
    monkeypatch.setenv(VARIABLE, str(PRODUCERS))
    handler = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, handler)


@pytest.fixture
def producers():
    with opened_producers() as opened:
        yield opened


def red(producers: Producers, **options: Any) -> Any:
    """The first camera, opened."""
    listed = producers.listing.cameras[0]
    return opened_camera(producers, listed, "red", SourceConfig(**options), 1.0)


def taken(camera: GenicamCamera, count: int) -> list[FetchedFrame]:
    """So many exposures, with pictures of their own."""
    found = []
    while len(found) < count:
        with camera.next() as one:
            if one is not None:
                pixels = one.pixels
                if pixels is not None:
                    frame_from_camera(pixels.data, pixels.height, pixels.width, pixels.pixel_format)
                found.append(one)
    return found


def test_what_is_listed_and_who_is_meant(producers):
    listing = producers.listing
    assert listing.camera("VikyTL_DEV_green") is listing.cameras[1]
    assert listing.camera("2") is listing.cameras[2]  # serial number and index
    assert listing == Listing.from_json(asdict(listing))
    refuses(r"no GenICam camera 'x': found 0: VikyTL_DEV_red .*serial", listing.camera, "x")
    # What a camera's process is told: a name, and where the camera was if that is known.
    assert _chosen(listing, {"name": "VikyTL_DEV_green", "place": None}) is listing.cameras[1]
    place = asdict(listing.cameras[2].place)
    assert _chosen(listing, {"name": "bow", "place": place}) is listing.cameras[2]
    for name, gone in (("bow", {**place, "device": "gone"}), ("not here yet", None)):
        words = f"no GenICam camera '{name}': found 0: Viky"
        refuses(words, _chosen, listing, {"name": name, "place": gone})


def test_who_is_meant_is_one_camera():
    place = Place("p", "i", "d")
    other = Place("p", "j", "e")
    cameras = (ListedCamera(place, "7", "bow"), ListedCamera(other, "8", "bow"))
    listing = Listing(("p",), cameras, ())
    assert listing.camera("7").place == listing.camera("0").place == place
    refuses("2 cameras are called 'bow'", listing.camera, "bow")
    refuses("no GenICam camera '2'", listing.camera, "2")


def test_no_producer(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, f"{tmp_path}{os.pathsep}{tmp_path / 'none'}")
    refuses(r"no GenTL producer \(\*\.cti\) in", producer_files)
    assert genicam_producers.genicam_finding().state == "note"
    monkeypatch.delenv(VARIABLE)
    refuses(f"install the camera vendor's, and set {VARIABLE}", producer_files)


def test_producers_that_are_none_are_said_and_others_used(monkeypatch, tmp_path):
    (tmp_path / "broken.cti").write_text("not a library")
    other = next((PRODUCERS).glob("libLog_*.so"))
    shutil.copy(other, tmp_path / "other.cti")
    monkeypatch.setenv(VARIABLE, os.pathsep.join((str(PRODUCERS), str(tmp_path), str(PRODUCERS))))
    with opened_producers() as opened:
        assert opened.listing.producers == (str(PRODUCERS / "viky.cti"),)
        assert len(opened.listing.cameras) == 3
        broken, no_producer = sorted(opened.listing.complaints)
    assert "broken.cti: " in broken and "other.cti: " in no_producer
    assert "broken.cti" in opened.listing.in_words()


def test_frames_and_the_buffers_given_back(producers):
    with red(producers, camera_rate=200) as camera:
        assert camera.period_s == pytest.approx(1 / 200)
        found = taken(camera, 20)
    numbers = [one.frame_id for one in found]
    assert numbers == sorted(set(numbers))
    assert {one.fault for one in found} == {NO_FAULT}
    assert {one.taken_s for one in found} == {None}  # viky has no clock
    pixels = found[-1].pixels
    assert (pixels.height, pixels.width, pixels.pixel_format) == (400, 400, "Mono8")
    assert np.all(np.diff([one.fetched_s for one in found]) >= 0)


def test_incomplete_frames_are_told_and_given_back(producers, monkeypatch):
    """viky sends none: its complete ones are declared incomplete, and harvesters does the rest."""
    calls = iter(range(1000))
    monkeypatch.setattr(genicam.gentl.Buffer, "is_complete", lambda self: next(calls) % 2 == 0)
    with red(producers, camera_rate=200) as camera:
        found = taken(camera, 24)
    halves = [one for one in found if one.pixels is None]
    assert len(halves) == 12
    assert {one.fault.reason for one in halves} == {Reason.INCOMPLETE}
    numbers = [one.frame_id for one in found]
    assert numbers == sorted(set(numbers))


class Stuck(io.BytesIO):
    """A pipe that nobody reads for longer than a period."""

    def flush(self) -> None:
        time.sleep(0.2)


def test_what_came_while_nobody_read_is_given_back(producers):
    pipe = Stuck()
    with red(producers, camera_rate=20) as camera:
        stream = producers.harvester.image_acquirers[0].data_streams[0]

        def given_back() -> bool:
            _send_next(pipe, camera)
            return bool(pipe.getvalue()) and stream.num_awaiting_delivery == 0

        until(given_back)  # at once, unless the next frame comes before it is looked at
        sent = json.loads(pipe.getvalue().partition(b"\n")[0])
        assert taken(camera, 1)[0].frame_id > sent["frame_id"] + 1
    assert (sent["bytes"], sent["reason"]) == (400 * 400, "ok")


def test_a_camera_that_is_pulled_out_can_be_opened_again(producers):
    """Its handles are closed under harvesters, as a producer does when its device is gone."""
    with red(producers) as camera, pytest.raises(camera.gone, match="handle"):
        taken(camera, 1)
        producers.harvester.image_acquirers[0].device.module.close()
        taken(camera, 1)
    with red(producers) as camera:
        assert taken(camera, 1)


def test_a_camera_in_use(producers):
    with red(producers):
        refuses("camera red cannot be opened: .*already in use", red(producers).__enter__)


def test_what_doctor_finds():
    found = genicam_producers.genicam_finding()
    assert found.state == "ok" and "harvesters" in found.text
    assert found.figures["cameras"] == ["VikyTL_DEV_red", "VikyTL_DEV_green", "VikyTL_DEV_blue"]


def test_without_harvesters_doctor_says_what_to_install(monkeypatch):
    def version(name: str) -> str:
        raise genicam_producers.PackageNotFoundError(name)

    monkeypatch.setattr(genicam_producers, "version", version)
    found = genicam_producers.genicam_finding()
    assert found.state == "note"
    assert found.text == "no harvesters; GenICam cameras need the extra 'genicam'"
