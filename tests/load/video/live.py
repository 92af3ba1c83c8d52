"""Live streams that fail and begin anew, through all of tokt's way from the socket to the frame."""

import random
import socket
import threading
import time

from tests.inference.sources.video.encoding import decoded, encode
from tests.inference.sources.video.network import Network
from tests.inference.sources.video.packets import MAX_SEQ, MAX_TIMESTAMP, RTCP, rtp_packets
from tests.inference.sources.video.senders import free_port
from tokt.features.common.arrays import U8
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.sources.open import open_camera_source

from .captures import Counted

_FRAMES, _KEY_EVERY, _SIZES = 30, 10, ((320, 240), (160, 96))
_PAUSES_S = 0.0, 0.05, 0.3, 1.0
_LOSSES = 0.0, 0.01, 0.05


def count_live(streams: int, codec: str = "h264", seed: int = 1) -> Counted:
    """Send so many streams to one port, one after the other, in real time."""
    films = [
        encode(codec, range(at * 100, at * 100 + _FRAMES), size, key_every=_KEY_EVERY)
        for at, size in enumerate(_SIZES)
    ]
    truth: dict[int, U8] = {}
    for film in films:
        truth |= dict(decoded(film, codec, "bgr24"))
    port, counted = free_port(), Counted()
    rng = random.Random(seed)
    lock, starts, ended = threading.Lock(), [0.0], threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for number in range(streams):
                packets = rtp_packets(
                    films[number % 2 if rng.random() < 0.3 else 0],
                    codec,
                    mtu=400,
                    ssrc=rng.randrange(1 << 32),
                    seq=rng.randrange(MAX_SEQ),
                    timestamp=rng.randrange(MAX_TIMESTAMP),
                    report_every=10,
                )
                faults = {"reorder": 0.02, "duplicate": 0.02, "garbage": 0.02}
                network = Network(number, loss=rng.choice(_LOSSES), **faults)
                began = time.monotonic()
                with lock:
                    starts[0] = began
                    counted.streams += 1
                    counted.sent += _FRAMES
                for packet in packets:
                    time.sleep(max(0.0, began + packet.t - time.monotonic()))
                    for data in network.pass_on(packet.data):
                        out.sendto(data, ("127.0.0.1", port + (packet.kind == RTCP)))
                time.sleep(rng.choice(_PAUSES_S))
        ended.set()

    sender = threading.Thread(target=send)
    sender.start()
    # On a busy machine all may be sent before anybody listens: then nothing comes, and no fault.
    wanted = SourceConfig(source=f"rtp://:{port}?codec={codec}", wait=True)
    source = open_camera_source(wanted, SYSTEM_CLOCK, lambda event: None)
    stopper = threading.Thread(target=lambda: (ended.wait(), time.sleep(0.5), source.stop()))
    stopper.start()
    try:
        for frame in source:
            now = time.monotonic()
            counted.take(frame.left, truth)
            with lock:
                if frame.left is not None and starts[0]:
                    counted.first_s.append(now - starts[0])
                    starts[0] = 0.0
    finally:
        ended.set()
        sender.join()
        stopper.join()
    return counted
