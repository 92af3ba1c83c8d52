"""`tokt cameras`: what is listed, what is tried, and what is said where nothing comes."""

import json
import sys
import tomllib

import cv2
import pytest

from tests.calls import run_python, succeeds
from tests.inference.sources.video.pictures import bgr
from tests.inference.sources.video.senders import mjpeg
from tests.inference.sources.video.v4l2_device import DAMAGED, WHOLE
from tokt.cli import cameras

pytestmark = pytest.mark.process


@pytest.fixture
def camera(device):
    """A USB camera of which each third picture is damaged."""
    pictures = [cv2.imencode(".jpg", bgr(number))[1].tobytes() for number in range(9)]
    kinds = (WHOLE, WHOLE, DAMAGED)
    device.sends("MJPG", *((kinds[n % 3], data) for n, data in enumerate(pictures)))
    return device


def test_without_a_camera_it_says_how_video_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(cameras, "_DEVICES", tmp_path)
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    said = succeeds("cameras").out
    assert "no camera at this computer" in said
    assert "note: no GenTL producer" in said
    assert "\n\nVideo of the network" in said and "rtp://:5600" in said
    found = json.loads(succeeds("cameras", "--json").out)
    assert found["cameras"] == []
    assert len(found["notes"]) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="Video4Linux")
def test_usb_cameras_are_listed_by_the_names_that_stay(camera):
    folder = camera.path.parent
    (folder / "video1").touch()  # no camera
    (folder / "v4l" / "by-id").mkdir(parents=True)
    link = folder / "v4l" / "by-id" / "usb-A_camera-index0"
    link.symlink_to(camera.path)
    program = "from pathlib import Path; from tokt.cli import cameras; "
    program += f"cameras._DEVICES = Path({str(folder)!r}); cameras.cameras(None, json={{}})"
    ran = run_python("-c", program.format(True), folder=folder)
    first, second = json.loads(ran.stdout)["cameras"]
    assert first["source"] == f"v4l2:{link}"
    assert first["name"] == f"A camera: of tests, {camera.path}: mjpeg"
    assert "Inappropriate ioctl" in second["name"]
    ran = run_python("-c", program.format(False), folder=folder)
    assert f"v4l2:{link}  (A camera: of tests" in ran.stdout


def test_a_camera_is_tried_and_its_section_printed(camera):
    named = f"{camera.url()}?size=320x240"
    said = succeeds("cameras", named, "--seconds", 1).out
    assert tomllib.loads(said) == {"source": {"source": named}}
    assert "# 320x240, " in said
    assert "without a picture: incomplete" in said
    assert "the driver says that it is damaged" in said
    tried = json.loads(succeeds("cameras", named, "--seconds", 1, "--json").out)
    assert tried["pictures"] > 3
    assert tried["without_picture"]["incomplete"] > 0
    assert 0 <= tried["age_s"]["median"] < 60


def test_a_password_is_not_printed(tmp_path):
    with mjpeg(tmp_path) as server:
        named = server.url.replace("http://", "http://me:secret@")
        ran = succeeds("cameras", named, "--seconds", 1)
    assert "secret" not in ran.out + ran.err
    assert "TOKT_SOURCE_PASSWORD" in ran.out
    assert tomllib.loads(ran.out)["source"]["source"] == server.url
