"""Vimba X's own library on the simulated cameras of the genicam package, and what goes wrong."""

import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.calls import refuses
from tests.waiting import until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.reason import Reason
from tokt.inference.sources.cameras.vimba import vimbax_system
from tokt.inference.sources.cameras.vimba.driver import open_drivers
from tokt.inference.sources.cameras.vimba.features import VimbaFeatures, set_features
from tokt.inference.sources.cameras.vimba.vimbax_system import VimbaXCamera, vimbax_finding
from tokt.inference.sources.open import open_camera_source

from .simulated_rig import Live

pytest.importorskip("vmbpy")
genicam = pytest.importorskip("genicam")
pytestmark = pytest.mark.process

RED, BLUE = "VikyTL_DEV_red", "VikyTL_DEV_blue"
GONE = ("VmbCameraOpen", "VmbCameraInfoQuery", "VmbCaptureFrameQueue")
CONFIGURATION = """<?xml version="1.0" standalone="no" ?>
<Settings><Logging><Level>Fatal</Level><Sinks></Sinks></Logging><TlLoading>
<CtiPaths><Path required="true">{folder}</Path></CtiPaths>
<TlRule vendor-type="*" interface-type="*" rule="allow"/>
</TlLoading></Settings>
"""


class Rig:
    """The library as it is, but for a camera that is pulled out."""

    def __init__(self, api, configuration):
        self.plugged = True
        self.running = 0
        self._api, self._configuration = api, configuration
        self._real = api.call_vmb_c

    def __call__(self, name, *arguments):
        if name == "VmbStartup":
            arguments = (self._configuration,)
        elif name == "VmbShutdown":
            self.running -= 1
        elif name == "VmbCamerasList" and not self.plugged:
            arguments[2]._obj.value = 0
            return
        elif not self.plugged and name in GONE:
            raise self._api.VmbCError(self._api.VmbError.NotFound)
        self._real(name, *arguments)
        self.running += name == "VmbStartup"
        # Each step of the end is refused, though in truth it was done.
        if not self.plugged and name not in ("VmbStartup", "VmbShutdown"):
            raise self._api.VmbCError(self._api.VmbError.BadHandle)


@pytest.fixture
def rig(monkeypatch, tmp_path):
    from vmbpy import c_binding
    from vmbpy.c_binding.vmb_common import _as_vmb_file_path

    file = tmp_path / "VmbC.xml"
    file.write_text(CONFIGURATION.format(folder=Path(genicam.__file__).parent))
    made = Rig(c_binding, _as_vmb_file_path(str(file)))
    monkeypatch.setattr(c_binding, "call_vmb_c", made)
    yield made
    assert made.running == 0


@pytest.fixture
def open_camera(rig, made_drivers):
    def make(*names, **options):
        wanted = SourceConfig(**{"pixel_format": "Mono8", "camera_rate": 100, **options})
        made_drivers.extend(open_drivers(names or [RED], wanted, SYSTEM_CLOCK, vimbax=True))
        return made_drivers[-1]

    return make


def test_pictures_are_copies_that_do_not_change(open_camera, delivered):
    one = open_camera()
    one.start(delivered)
    first = delivered.wait(1)[0].picture
    before = first.copy()
    captures = delivered.wait(20)  # more than there are buffers
    one.stop()
    assert first.shape == (400, 400) and first.dtype == np.uint8 and np.ptp(first) > 0
    assert np.array_equal(first, before)
    assert all(each.picture.flags.owndata and not each.fault for each in captures)
    assert len({each.picture.tobytes() for each in captures}) > 10  # balls fly
    assert np.diff([each.frame_id for each in captures]).min() >= 1
    assert one.period_s == pytest.approx(1 / 100) and one.failures == 0
    assert all(np.isnan(each.taken_s) for each in captures)  # viky has no clock


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exposure_us": 500}, "no ExposureTimeAbs or ExposureTime: no exposure to set"),
        ({"camera_rate": 1e9}, r"refuses AcquisitionFrameRate = 1000000000.0 \(it has "),
        ({"pixel_format": "BGR8"}, "no pixel format BGR8: it has .*Mono8"),
        ({"trigger": "Line1", "camera_rate": None}, "no TriggerSource"),
        ({"ptp": True}, "no PtpMode"),
    ],
)
def test_what_cannot_be_set_is_refused_and_closed(options, words, open_camera, delivered):
    one = open_camera(**options)
    refuses(words, one.start, delivered)
    other = open_camera()
    other.start(delivered)  # it is free
    delivered.wait(1)


def test_what_a_feature_is_while_it_cannot_be_read_and_in_which_steps_it_is_set(
    open_camera, delivered
):
    one = open_camera()
    one.start(delivered)
    camera = one._stream._camera
    assert camera.feature("Scan3dOutputMode").value is None
    assert camera.feature("PixelFormat").range == ["RGBa8", "Mono8"]
    assert camera.feature("Height").step >= 1


class Bare:
    """Features with a value each, and what range and step a link's limit has."""

    def __init__(self, **values):
        self.values = values
        self.set = {}

    def feature_names(self):
        return list(self.values)

    def feature(self, name):
        bare = self

        class Feature:
            range = (1000, 400_000_000)
            step = 4000

            @property
            def value(self):
                return bare.values[name]

            @value.setter
            def value(self, wanted):
                bare.set[name] = bare.values[name] = wanted

        return Feature()


@pytest.mark.parametrize(
    ("gige", "asked", "expected"),
    [
        (True, None, 114_997_000),
        (False, None, None),
        (False, 60e6, 59_997_000),
        (True, 1e9, 399_997_000),
    ],
)
def test_the_link_of_newer_cameras_is_limited_in_its_steps(gige, asked, expected):
    """The simulated cameras have no such feature."""
    there = {"GevSCPSPacketSize": 1500} if gige else {}
    limit = {"DeviceLinkThroughputLimit": 1, "DeviceLinkThroughputLimitMode": "Off"}
    camera = Bare(PixelFormat="Mono8", AcquisitionMode="Continuous", **limit, **there)
    features = VimbaFeatures(camera, (KeyError,), "0", SYSTEM_CLOCK)
    features.entries = lambda name: ["Mono8"] if name == "PixelFormat" else []
    set_features(features, SourceConfig(bandwidth=asked), 1.0)
    assert camera.set.get("DeviceLinkThroughputLimit") == expected
    assert camera.set.get("DeviceLinkThroughputLimitMode") == (expected and "On")


def test_a_camera_without_a_command_is_refused_and_closed(open_camera, delivered, monkeypatch):
    monkeypatch.setattr(VimbaXCamera, "run_feature_command", lambda _, name: {}[name])
    refuses("does not stream: 'AcquisitionStart'", open_camera().start, delivered)


def test_an_unknown_camera_and_one_in_use(open_camera, delivered):
    words = refuses("no camera 'DEV_1'", open_camera("DEV_1").start, delivered)
    assert RED in words and BLUE in words
    first, same = open_drivers([RED, "0"], SourceConfig(), SYSTEM_CLOCK, vimbax=True)
    first.start(delivered)
    refuses("in use by another program", same.start, delivered)
    first.stop()


def test_a_picture_that_does_not_fit_its_buffer_is_damaged(open_camera, delivered, monkeypatch):
    real = VimbaXCamera.image

    def image(camera, frame):
        frame.height = 1_000_000
        return real(camera, frame)

    monkeypatch.setattr(VimbaXCamera, "image", image)
    open_camera().start(delivered)
    capture = delivered.wait(1)[0]
    assert capture.picture is None and capture.fault.reason is Reason.DAMAGED


def test_a_camera_pulled_out_is_lost_and_comes_back(rig):
    wanted = SourceConfig(f"vimbax:{RED}", pixel_format="Mono8", camera_rate=100)
    events = []
    with closing(open_camera_source(wanted, SYSTEM_CLOCK, events.append)) as source:
        live = Live(source, events)
        live.until(lambda frame: frame.left is not None)
        rig.plugged = False
        live.until(lambda frame: frame.left_fault.reason is Reason.CAMERA_LOST)
        rig.plugged = True
        live.until(lambda frame: frame.left is not None)
        until(lambda: len(events) >= 2)
        assert live.event_names[:2] == [("camera_lost", "left"), ("camera_back", "left")]


def test_without_transport_layers_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(tmp_path))
    (one,) = open_drivers([RED], SourceConfig(), SYSTEM_CLOCK, vimbax=True)
    assert "install Vimba X and set GENICAM_GENTL64_PATH" in refuses("", one.start, print)
    finding = vimbax_finding()
    assert finding.state == "note" and "install Vimba X" in finding.text


@pytest.mark.parametrize(
    ("program", "state", "words"),
    [
        ("print('VmbC 1.3.2')", "ok", "with VmbC 1.3.2"),
        ("import os; os.abort()", "fault", "ended with -6"),
        ("import time; time.sleep(60)", "fault", "does not answer in 1 s"),
    ],
)
def test_the_doctor_tries_the_library_in_another_process(program, state, words, monkeypatch):
    monkeypatch.setattr(vimbax_system, "_PROGRAM", program)
    finding = vimbax_finding(1.0 if "sleep" in program else 60.0)
    assert finding.state == state and words in finding.text


def test_no_vmbpy_names_the_extra(monkeypatch):
    monkeypatch.setattr(vimbax_system, "installed_version", lambda _: None)
    refuses("extra 'vimbax'", open_drivers, [RED], SourceConfig(), SYSTEM_CLOCK, True)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if "site-packages" not in entry])
    assert vimbax_finding().state == "note"


def test_a_library_that_does_not_load_is_one_line(monkeypatch, tmp_path):
    package = tmp_path / "vmbpy"
    package.mkdir()
    (package / "__init__.py").write_text("raise OSError('no library')\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "vmbpy"]:
        monkeypatch.delitem(sys.modules, name)
    words = refuses("", open_drivers, [RED], SourceConfig(), SYSTEM_CLOCK, True)
    assert words == "vmbpy cannot load its library: no library"
