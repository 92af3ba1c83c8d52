"""Setting a camera: the real GenApi, with feature descriptions as cameras have them."""

from typing import Any

import pytest

from tests.calls import refuses
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.genicam.features import GenicamFeatures

NodeMap = pytest.importorskip("genicam.genapi").NodeMap

HEAD = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1" ModelName="Test"
 VendorName="tokt" StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1"
 SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
 ProductGuid="11111111-1111-1111-1111-111111111111"
 VersionGuid="11111111-1111-1111-1111-111111111112">
"""


def number(name: str, low: float, high: float, kind: str = "Float", step: str = "") -> str:
    limits = f"<Min>{low}</Min><Max>{high}</Max>{step}"
    return f'<{kind} Name="{name}"><Value>{low}</Value>{limits}</{kind}>'


def choice(name: str, *entries: str) -> str:
    inner = "".join(
        f'<EnumEntry Name="{entry}"><Value>{i}</Value></EnumEntry>'
        for i, entry in enumerate(entries)
    )
    return f'<Enumeration Name="{name}">{inner}<Value>0</Value></Enumeration>'


def switch(name: str) -> str:
    return f'<Boolean Name="{name}"><Value>0</Value></Boolean>'


def camera(*features: str, formats: tuple[str, ...] = ("Mono8",)) -> tuple[Any, GenicamFeatures]:
    nodes = NodeMap()
    described = "".join((choice("PixelFormat", *formats), *features))
    nodes.load_xml_from_string(f"{HEAD}{described}</RegisterDescription>")
    return nodes, GenicamFeatures(nodes, "cam")


@pytest.mark.parametrize(
    ("own", "wanted", "chosen"),
    [
        (("BayerRG8", "Mono8"), None, "BayerRG8"),
        (("Mono12Packed", "RGBa8", "BGR8Packed"), None, "BGR8Packed"),
        (("Mono8", "BGR8Packed"), "BGR8", "BGR8Packed"),
        (("Mono8", "RGB8"), "RGB8Packed", "RGB8"),
    ],
)
def test_the_pixel_format(own, wanted, chosen):
    nodes, features = camera(formats=own)
    features.set_up(SourceConfig(pixel_format=wanted), 1.0, "U3V")
    assert nodes.PixelFormat.value == chosen


@pytest.mark.parametrize("wanted", [None, "BGR8"])
def test_no_pixel_format_that_fits(wanted):
    _, features = camera(formats=("Mono12", "Mono12Packed"))
    words, options = "it has Mono12, Mono12Packed", SourceConfig(pixel_format=wanted)
    refuses(words, features.set_up, options, 1.0, "U3V")


@pytest.mark.parametrize("name", ["ExposureTime", "ExposureTimeAbs"])
def test_exposure_gain_and_packets_under_each_name(name):
    nodes, features = camera(
        choice("ExposureAuto", "Continuous", "Off"),
        choice("GainAuto", "Continuous", "Off"),
        number(name, 10, 1e6),
        number("Gain", -6, 24),
        number("GevSCPSPacketSize", 500, 9000, "Integer"),
    )
    features.set_up(SourceConfig(exposure_us=2500, gain_db=-3, packet_size=8228), 1.0, "GEV")
    assert (nodes.ExposureAuto.value, nodes.GainAuto.value) == ("Off", "Off")
    assert getattr(nodes, name).value == 2500
    assert (nodes.Gain.value, nodes.GevSCPSPacketSize.value) == (-3, 8228)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (SourceConfig(exposure_us=5.0), "does not take ExposureTime 5.0: Value"),
        (SourceConfig(gain_db=1.0), "no gain in dB that could be set"),
        (SourceConfig(packet_size=1500), "no packet size that could be set"),
        (SourceConfig(bandwidth=5e6), "no bandwidth that could be set"),
        (SourceConfig(camera_rate=5.0), "no frame rate that could be set"),
        (SourceConfig(trigger="Line1"), "does not take TriggerSource Line1"),
        (SourceConfig(ptp=True), "no Precision Time Protocol"),
    ],
)
def test_what_a_camera_cannot_do_is_refused(options, words):
    _, features = camera(number("ExposureTime", 10, 1e6), choice("TriggerSource", "Software"))
    refuses(words, features.set_up, options, 1.0, "GEV")


@pytest.mark.parametrize(
    ("asked", "share", "link", "given"),
    [
        (None, 0.5, "GEV", 57_500_000),  # the default, halved, in steps of 8 from 1000
        (None, 0.5, "U3V", 1000),  # another link has a bandwidth of its own
        (20e6, 0.5, "U3V", 10_000_000),
        (1e12, 1.0, "GEV", 125_000_000),
        (10.0, 1.0, "GEV", 1000),
    ],
)
@pytest.mark.parametrize("name", ["DeviceLinkThroughputLimit", "StreamBytesPerSecond"])
def test_the_bandwidth_is_shared_and_kept_within_what_the_camera_can(
    name, asked, share, link, given
):
    nodes, features = camera(number(name, 1000, 125_000_000, "Integer", "<Inc>8</Inc>"))
    options = SourceConfig() if asked is None else SourceConfig(bandwidth=asked)
    features.set_up(options, share, link)
    assert given - 8 < getattr(nodes, name).value <= given


def test_a_frame_rate_and_the_period_that_comes_of_it():
    nodes, features = camera(
        choice("TriggerMode", "On", "Off"),
        switch("AcquisitionFrameRateEnable"),
        number("AcquisitionFrameRate", 1, 30),
    )
    assert features.period_s() is None  # triggered
    features.set_up(SourceConfig(camera_rate=20), 1.0, "U3V")
    assert nodes.TriggerMode.value == "Off" and nodes.AcquisitionFrameRateEnable.value
    assert features.period_s() == pytest.approx(1 / 20)


def test_a_frame_rate_that_is_a_trigger():
    """As GigE cameras of Allied Vision have it."""
    nodes, features = camera(
        choice("TriggerMode", "Off", "On"),
        choice("TriggerSource", "Freerun", "FixedRate"),
        number("AcquisitionFrameRateAbs", 1, 30),
    )
    features.set_up(SourceConfig(camera_rate=10), 1.0, "GEV")
    assert (nodes.TriggerMode.value, nodes.TriggerSource.value) == ("On", "FixedRate")
    assert features.period_s() == pytest.approx(0.1)


def test_a_trigger():
    nodes, features = camera(
        choice("TriggerSelector", "FrameBurstStart", "FrameStart"),
        choice("TriggerSource", "Software", "Line1"),
        choice("TriggerMode", "Off", "On"),
    )
    features.set_up(SourceConfig(trigger="Line1"), 1.0, "GEV")
    values = (nodes.TriggerSelector.value, nodes.TriggerSource.value, nodes.TriggerMode.value)
    assert values == ("FrameStart", "Line1", "On")


@pytest.mark.parametrize(
    ("enable", "status", "on"),
    [
        (switch("PtpEnable"), choice("PtpStatus", "Slave"), True),
        (switch("GevIEEE1588"), choice("GevIEEE1588Status", "Master"), True),
        (choice("PtpMode", "Off", "Auto"), choice("PtpStatus", "Master"), "Auto"),
    ],
    ids=["PtpEnable", "GevIEEE1588", "PtpMode"],
)
def test_a_clock_that_is_set_by_ptp(enable, status, on, request):
    nodes, features = camera(enable, status)
    features.set_up(SourceConfig(ptp=True), 1.0, "GEV")
    assert getattr(nodes, request.node.callspec.id).value == on
    assert features.clock_is_shared()


def test_a_clock_that_is_not_set(monkeypatch):
    monkeypatch.setattr("tokt.inference.sources.cameras.genicam.features._PTP_S", 0.0)
    nodes, _ = camera(switch("PtpEnable"), choice("PtpStatus", "Listening", "Slave"))
    features = GenicamFeatures(nodes, "cam")
    assert not features.clock_is_shared()
    words = "camera cam: no clock by PTP in 0 s"
    refuses(words, features.set_up, SourceConfig(ptp=True), 1.0, "GEV")
