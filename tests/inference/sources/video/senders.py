"""Cameras on the loopback as owners have them: programs that encode and send, as processes.

Each is used as ``with ffmpeg_rtp(tmp_path) as camera``; ``camera.url`` is what a reader is given.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from .stamps import Stamps

ROOT = Path(__file__).resolve().parents[4]
HERE = Path(__file__).parent
SYSTEM_PYTHON = "/usr/bin/python3"
_END_S = 10.0


def _has_gst_rtsp() -> bool:
    code = "import gi; gi.require_version('GstRtspServer', '1.0')"
    try:
        return subprocess.run([SYSTEM_PYTHON, "-c", code], capture_output=True).returncode == 0
    except OSError:
        return False


needs_ffmpeg = pytest.mark.skipif(not shutil.which("ffmpeg"), reason="apt-get install ffmpeg")
needs_gst = pytest.mark.skipif(
    not shutil.which("gst-launch-1.0"), reason="apt-get install gstreamer1.0-tools"
)
needs_gst_rtsp = pytest.mark.skipif(
    not _has_gst_rtsp(), reason="apt-get install gir1.2-gst-rtsp-server-1.0 python3-gi"
)


@dataclass(frozen=True)
class Film:
    """What is sent."""

    codec: str = "h264"
    size: tuple[int, int] = (320, 240)
    rate: int = 30
    key_every: int = 30
    kbit: int = 500


FILM = Film()


def free_port() -> int:
    """An even UDP port of the loopback that nobody has, nor the next one: RTCP's."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.bind(("127.0.0.1", 0))
            port = int(one.getsockname()[1])
            if port % 2:
                continue
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as next_one, suppress(OSError):
                next_one.bind(("127.0.0.1", port + 1))
                return port


@dataclass
class Sender:
    """Processes that send; `commands` gives their command lines from the first picture's number.

    Where there are two, the first one's output is the second one's input.
    """

    film: Film
    stamps: Stamps
    commands: Callable[[int], list[list[str]]]
    url: str = ""
    url_of: Callable[[int], str] | None = None  # of the port that the last program prints
    said: Path = Path(os.devnull)
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def __enter__(self) -> "Sender":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Begin, with the number after the last one."""
        source: Any = subprocess.DEVNULL
        commands = self.commands(self.stamps.last() + 1)
        for place, command in enumerate(commands):
            last = place == len(commands) - 1
            sink = subprocess.DEVNULL if last and self.url_of is None else subprocess.PIPE
            with self.said.open("ab") as errors:
                streams = {"stdin": source, "stdout": sink, "stderr": errors}
                process = subprocess.Popen(command, cwd=ROOT, **streams)
            if place:
                source.close()
            source = process.stdout
            self._running.append(process)
        if self.url_of:
            line = source.readline()
            assert line, f"the sender ended: {self.said.read_text('utf-8', 'replace')[-2000:]}"
            self.url = self.url_of(int(line))

    def stop(self) -> None:
        """End all of its processes."""
        self.resume()
        for process in self._running:
            process.terminate()
        for process in self._running:
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout:
                process.stdout.close()
        self._running.clear()

    def pause(self) -> None:
        """Hang: nothing is sent, nothing is closed."""
        for process in self._running:
            process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Go on after `pause`."""
        for process in self._running:
            process.send_signal(signal.SIGCONT)

    def restart(self) -> None:
        """End and begin anew at the same place: the camera was switched off and on."""
        self.stop()
        self.start()


def _feed(film: Film, first: int, stamps: Path | str) -> list[str]:
    here = [sys.executable, "-m", "tests.inference.sources.video.feed"]
    return [*here, *map(str, (*film.size, film.rate, first, stamps))]


def _ffmpeg(film: Film, *output: str) -> list[str]:
    side = "x".join(map(str, film.size))
    command = ["ffmpeg", "-hide_banner", "-loglevel", "warning", "-nostdin", "-fflags", "nobuffer"]
    command += ["-probesize", "32", "-analyzeduration", "0", "-f", "rawvideo", "-pix_fmt"]
    command += ["yuv420p", "-s", side, "-framerate", str(film.rate), "-i", "pipe:0"]
    command += ["-c:v", {"h264": "libx264", "h265": "libx265"}[film.codec]]
    command += ["-preset", "ultrafast", "-tune", "zerolatency", "-threads", "1"]
    command += ["-g", str(film.key_every), "-keyint_min", str(film.key_every)]
    command += ["-b:v", f"{film.kbit}k", "-maxrate", f"{film.kbit}k", "-bufsize", f"{film.kbit}k"]
    if film.codec == "h265":
        command += ["-x265-params", "log-level=error:pools=1"]
    return [*command, "-flush_packets", "1", *output]


def _gst_encoder(film: Film) -> str:
    """The part of a pipeline from raw pictures to RTP packets, as BlueOS has it."""
    name = {"h264": "x264enc", "h265": "x265enc"}[film.codec]
    encoder = f"{name} tune=zerolatency speed-preset=ultrafast bitrate={film.kbit} "
    encoder += f"key-int-max={film.key_every}"
    # x265's key pictures in the middle of a stream are else without parameter sets.
    own = {"h264": " threads=1", "h265": " option-string=open-gop=0:repeat-headers=1"}
    encoder += own[film.codec]
    payload = film.codec.replace("h", "rtph") + "pay"
    profile = f"video/x-{film.codec},stream-format=byte-stream"
    return f"{encoder} ! {profile} ! {payload} config-interval=-1"


def _sender(folder: Path, film: Film, name: str, **more: Any) -> Sender:
    stamps = folder / f"{name}.stamps"
    return Sender(film, Stamps(stamps), said=folder / f"{name}.txt", **more)


def _ffmpeg_sender(folder: Path, film: Film, form: str, to: str, url: str) -> Sender:
    name = f"ffmpeg-{form}"
    feed, send = folder / f"{name}.stamps", _ffmpeg(film, "-f", form, to)
    return _sender(
        folder, film, name, commands=lambda first: [_feed(film, first, feed), send], url=url
    )


def ffmpeg_rtp(folder: Path, film: Film = FILM, port: int | None = None) -> Sender:
    """FFmpeg that sends RTP to a port."""
    to = f"rtp://127.0.0.1:{port or free_port()}?"
    return _ffmpeg_sender(folder, film, "rtp", f"{to}pkt_size=1200", f"{to}codec={film.codec}")


def ffmpeg_ts(folder: Path, film: Film = FILM, port: int | None = None) -> Sender:
    """FFmpeg that sends MPEG-TS to a UDP port."""
    to = f"udp://127.0.0.1:{port or free_port()}"
    return _ffmpeg_sender(folder, film, "mpegts", f"{to}?pkt_size=1316", to)


def gst_rtp(folder: Path, film: Film = FILM, port: int | None = None) -> Sender:
    """GStreamer that sends RTP to a port, as BlueOS does."""
    port = port or free_port()
    width, height = film.size
    source = f"fdsrc fd=0 blocksize={width * height * 3 // 2} ! rawvideoparse format=i420 "
    source += f"width={width} height={height} framerate={film.rate}/1"
    sink = f"udpsink host=127.0.0.1 port={port} sync=false"
    pipeline = f"{source} ! {_gst_encoder(film)} ! {sink}"
    return _sender(
        folder,
        film,
        "gst-rtp",
        commands=lambda first: [
            _feed(film, first, folder / "gst-rtp.stamps"),
            ["gst-launch-1.0", "-q", *pipeline.split()],
        ],
        url=f"rtp://127.0.0.1:{port}?codec={film.codec}",
    )


def rtsp(
    folder: Path, film: Film = FILM, user: str = "", password: str = "", auth: str = "digest"
) -> Sender:
    """GStreamer's RTSP server: UDP or TCP as the client asks; basic or digest authentication."""
    port = 0

    def url_of(bound: int) -> str:
        nonlocal port
        port = bound
        who = f"{user}:{password}@" if user else ""
        return f"rtsp://{who}127.0.0.1:{bound}/video"

    def commands(first: int) -> list[list[str]]:
        told = {"size": film.size, "rate": film.rate, "port": port, "first": first}
        told |= {"user": user, "password": password, "auth": auth}
        told |= {"pipeline": _gst_encoder(film), "stamps": str(folder / "rtsp.stamps")}
        script = str(HERE / "rtsp_server.py")
        return [_feed(film, first, "-"), [SYSTEM_PYTHON, script, json.dumps(told)]]

    return _sender(folder, film, "rtsp", commands=commands, url_of=url_of)


def mjpeg(folder: Path, film: Film = FILM) -> Sender:
    """JPEGs over HTTP."""
    port = 0

    def url_of(bound: int) -> str:
        nonlocal port
        port = bound
        return f"http://127.0.0.1:{bound}/stream.mjpg"

    def commands(first: int) -> list[list[str]]:
        here = [sys.executable, "-m", "tests.inference.sources.video.mjpeg_server"]
        told = (*film.size, film.rate, first, folder / "mjpeg.stamps", port)
        return [[*here, *map(str, told)]]

    return _sender(folder, film, "mjpeg", commands=commands, url_of=url_of)
