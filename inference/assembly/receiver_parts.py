"""The receivers of a run, and the link by which the vehicle's place is heard, as parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring.receivers import PlaceWatch, ReceiverWatch
from tokt.inference.outputs.udp import DEFAULT_RECEIVER, UdpSender, parse_receiver, version_of
from tokt.inference.publisher import Sender

from .parts import RECEIVER, Part
from .run_state import RunState

if TYPE_CHECKING:
    from tokt.inference.links.link import Link
    from tokt.inference.outputs.mavlink import MavlinkSender


def receiver_parts(state: RunState) -> Iterator[Part]:
    """Yield each receiver, and the link that tells the vehicle's place."""
    outputs = state.config.outputs
    state.observers.append(ReceiverWatch(state.senders, SYSTEM_CLOCK, state.events.put))
    receivers: dict[str, tuple[list[str], Callable[[RunState, str], Sender]]] = {
        "udp": (outputs.udp or [DEFAULT_RECEIVER], _open_udp),
        "mavlink": (outputs.mavlink or [], _open_mavlink),
    }
    for option, (texts, opener) in receivers.items():
        for text in texts:
            yield Part(
                option=option,
                value=text,
                open=partial(opener, state, text),
                join=partial(state.send_to, text),
                kind=RECEIVER,
            )
    nmea = state.config.source.nmea
    place = PlaceWatch(SYSTEM_CLOCK, state.events.put)
    if nmea is not None or outputs.mavlink:
        state.observers.append(place)
    if nmea is not None:

        def join(link: Link) -> None:
            state.opened.callback(link.close)
            place.why = lambda: link.last_error

        yield Part("nmea", nmea, open=partial(_open_nmea, state, nmea), join=join)


def _open_udp(state: RunState, text: str) -> UdpSender:
    receiver = parse_receiver(text, version_of(state.config.outputs.format))
    return UdpSender(receiver.host, receiver.port, receiver.version)


def _open_mavlink(state: RunState, text: str) -> MavlinkSender:
    from tokt.inference.links.link import open_link
    from tokt.inference.outputs.mavlink import MavlinkSender, check_mavlink, lens_of
    from tokt.inference.stereo.calibration import load_calibration

    outputs, path = state.config.outputs, state.config.stereo.calibration
    check_mavlink(outputs)
    angle_given = outputs.camera_fov_deg is not None
    calibration = None if path is None or angle_given else load_calibration(path)
    lens = lens_of(outputs.camera_fov_deg, calibration)
    return MavlinkSender(
        open_link(text), lens, outputs, SYSTEM_CLOCK, state.vehicle, state.events.put
    )


def _open_nmea(state: RunState, text: str) -> Link:
    from tokt.inference.links.link import open_link
    from tokt.inference.links.nmea import NmeaReader

    if text.strip().startswith("udpout:"):
        raise ToktError("--nmea only listens: write udpin:HOST:PORT")
    link = open_link(text)
    link.listen(NmeaReader(state.vehicle, state.config.source.nmea_dpt, link.whole).heard)
    return link
