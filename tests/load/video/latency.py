"""From the encoder to the datagram: tokt's run, bare codecs, other readers of the same stream."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import av

from tests.inference.sources.video.encoding import decoder_of, encode, open_encoder
from tests.inference.sources.video.network import Network
from tests.inference.sources.video.packets import annex_b, nal_units, rtp_packets, sdp
from tests.inference.sources.video.pictures import i420
from tests.inference.sources.video.senders import ROOT, Film, Sender, free_port
from tests.load.program import ended, program
from tests.load.report import percentiles
from tests.load.scale.cost import usage_of
from tests.load.soak.feed import datagram, receiver
from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import decode

from .model import Told, telling_bundle
from .readers import Read, Task

_WARM_S = 3.0
_SLACK_S = 60.0
_WHOLE_S = 2.0  # at either end of a film nothing is lost: a reader looks at it before it begins


@dataclass(frozen=True)
class Latency:
    """Times of one way, ms."""

    way: str
    median_ms: float
    p99_ms: float
    count: int
    cpu_share: float | None = None  # of a core


def latency(way: str, times_ms: list[float], cpu_share: float | None = None) -> Latency:
    if not times_ms:
        raise ToktError(f"{way}: no picture came")
    found = percentiles(times_ms, median_ms=50, p99_ms=99)
    return Latency(way, **found, count=len(times_ms), cpu_share=cpu_share)


def bare_codec(film: Film, pictures: int) -> Latency:
    """Encode and decode in this process, and convert to BGR: what no reader can do without."""
    encoder = open_encoder(film.codec, film.size, film.rate, film.key_every, film.kbit * 1000)
    decoder = decoder_of(film.codec)
    times = []
    for number in range(pictures):
        picture = i420(number, film.size)
        began = time.perf_counter()
        frame = av.VideoFrame.from_ndarray(picture, format="yuv420p")
        frame.pts, frame.time_base = number, Fraction(1, film.rate)
        for packet in encoder.encode(frame):
            for shown in decoder.decode(packet):
                shown.to_ndarray(format="bgr24")
                times.append(1e3 * (time.perf_counter() - began))
    return latency(f"bare codec, {film.codec}", times)


def run_latency(folder: Path, camera: Sender, url: str, way: str, seconds: float) -> Latency:
    """`tokt run` on a live camera: from when a picture goes into the encoder to its datagram."""
    film = camera.film
    bundle = folder / "telling.tokt"
    if not bundle.exists():
        bundle.write_bytes(telling_bundle(film.size, film.kbit * 1000))
    told, times, said = Told(film.size), [], folder / f"said-{way}"
    with receiver() as heard:
        options = ["--source", url, "--bundle", bundle, "--policy", "texture"]
        options += ["--udp", f"v2@127.0.0.1:{heard.getsockname()[1]}"]
        with program("run", *options, said=said) as process:
            began = spent = None
            while began is None or time.monotonic() < began + seconds:
                if (data := datagram(heard, _SLACK_S)) is None:
                    raise ended("run", process, said)
                now, verdict = time.monotonic(), decode(data)
                if began is None and verdict.get("status") == 1:
                    began, spent = now + _WARM_S, None
                if began is None or now < began:
                    continue
                if spent is None:
                    spent = usage_of(process.pid)[2]
                number = told.number(verdict.get("box"), camera.stamps.last())
                at = None if number is None else camera.stamps.of(number)
                if at is not None:
                    times.append(1e3 * (now - at))
            share = (usage_of(process.pid)[2] - (spent or 0.0)) / seconds
    return latency(way, times, share)


def read_by(task: Task, send: Callable[[], object] = lambda: None) -> Read:
    """A reader in a process of its own, to its end; what it reads is sent once it is ready."""
    command = [sys.executable, "-m", "tests.load.video.readers", json.dumps(asdict(task))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            assert process.stdout
            if process.stdout.readline() != "ready\n":
                raise ToktError(f"the reader {task.reader} does not begin")
            send()
            out, _ = process.communicate(timeout=task.seconds + 5 * _SLACK_S)
        finally:
            process.kill()
    if process.returncode:
        raise ToktError(f"the reader {task.reader} ended with {process.returncode}")
    return Read(**json.loads(out.splitlines()[-1]))


def reader_latency(folder: Path, camera: Sender, reader: str, seconds: float) -> Latency:
    """The same up to the picture in BGR, by one of `readers.READERS`."""
    stamps = folder / "rtsp.stamps"
    task = Task(reader, camera.url, stamps=str(stamps), seconds=seconds + _WARM_S, warm_s=_WARM_S)
    found = read_by(task)
    return latency(f"{reader}, RTSP to BGR", found.latency_ms, found.cpu_s / (seconds + _WARM_S))


def lossy_read(folder: Path, reader: str, loss: float, film: Film, pictures: int) -> Read:
    """Read a film with a share of its packets lost, in real time; the same packets for each."""
    units = encode(film.codec, pictures, film.size, film.rate, film.key_every, film.kbit * 1000)
    whole, port = folder / f"film.{film.codec}", free_port()
    whole.write_bytes(b"".join(annex_b(nal_units(unit.data)) for unit in units))
    (folder / "film.sdp").write_text(sdp(port, film.codec))
    packets, network = rtp_packets(units, film.codec), Network(1, loss=loss)
    task = Task(
        *(reader, f"rtp://:{port}?codec={film.codec}", str(folder / "film.sdp")),
        film=str(whole),
        last=units[-1].number - film.rate // 2,
        seconds=pictures / film.rate + 20,
    )

    def send() -> None:
        with receiver() as out:
            began, end = time.monotonic() + 1.0, packets[-1].t - _WHOLE_S
            for packet in packets:
                time.sleep(max(0.0, began + packet.t - time.monotonic()))
                lossy = _WHOLE_S < packet.t < end
                for data in network.pass_on(packet.data) if lossy else [packet.data]:
                    out.sendto(data, ("127.0.0.1", port))

    return read_by(task, send)
