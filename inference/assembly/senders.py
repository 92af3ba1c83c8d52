"""The receivers of a run, and what is heard of the vehicle."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing

from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig, SourceConfig
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.outputs.udp import DEFAULT_RECEIVER, UdpSender, parse_receiver, version_of
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.publisher import Sender
from tokt.inference.report import EventQueue


def read_nmea(wanted: SourceConfig, vehicle: VehicleState, opened: ExitStack) -> Callable[[], str]:
    """Hear where the vehicle is, where that was asked for; gives what fails of that."""
    if wanted.nmea is None:
        return str
    from tokt.inference.links.link import open_link
    from tokt.inference.links.nmea import NmeaReader

    if wanted.nmea.strip().startswith("udpout:"):
        raise ToktError("--nmea only listens: write udpin:HOST:PORT")
    link = opened.enter_context(closing(open_link(wanted.nmea)))
    link.listen(NmeaReader(vehicle, wanted.nmea_dpt, link.whole).heard)
    return lambda: link.last_error


def open_senders(
    config: RunConfig,
    pairs: StereoSetup | None,
    vehicle: VehicleState,
    events: EventQueue,
    opened: ExitStack,
) -> dict[str, Sender]:
    """Every receiver's sender, by what the user called it; closed with `opened`."""
    version = version_of(config.outputs.format)
    senders: dict[str, Sender] = {}

    def keep(text: str, sender: Sender) -> None:
        opened.callback(sender.close)
        # The same receiver may be named twice.
        senders[text if text not in senders else f"{text} ({len(senders) + 1})"] = sender

    for text in config.outputs.udp or [DEFAULT_RECEIVER]:
        keep(text, UdpSender(*parse_receiver(text, version)))
    if config.outputs.mavlink:
        from tokt.inference.links.link import open_link
        from tokt.inference.outputs.mavlink import MavlinkSender, check_mavlink, lens_of

        wanted = config.outputs
        check_mavlink(wanted)
        lens = lens_of(wanted.camera_fov_deg, None if pairs is None else pairs.calibration)
        for text in config.outputs.mavlink:
            told = vehicle, events.put
            keep(text, MavlinkSender(open_link(text), lens, wanted, SYSTEM_CLOCK, *told))
    return senders
