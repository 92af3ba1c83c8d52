"""Kinds of changed datagrams, logs, recordings, pictures and video, and of what a link hears."""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from tests.inference.sources.video.encoding import encode
from tests.inference.sources.video.packets import transport_stream
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import read_image
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.links.autopilot import MavlinkReader, mavlink_dialect
from tokt.inference.links.nmea import NmeaReader
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.outputs.udp import decode, encode_v1, encode_v2
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.recording import FILE_NAME, RECORDING_FORMAT
from tokt.inference.recording.run_log import event_line, frame_line, heartbeat_line
from tokt.inference.recording.run_start import ModelName, RunStart, UsedFile
from tokt.inference.replay.export import export_log
from tokt.inference.replay.logged_run import open_run
from tokt.inference.replay.shadow_report import read_shadow
from tokt.inference.report import Event, Report
from tokt.inference.sources.video.mjpeg import Parts
from tokt.inference.sources.video.mpegts import TransportReader
from tokt.inference.sources.video.newest import StreamLostError
from tokt.inference.verdict import unknown_verdict, verdict_from_mask

from .case import Files, Kind, alone, change_one, sound
from .changes import chance, text_of
from .containers import changed_png, some_picture

_RUN = "run-20160420-101112-3fa2c1"
_T = 1461147072.0
_MAX_DATAGRAM = 65_507
_UNKNOWN = unknown_verdict(Fault(Reason.DARK, "too dark"))


@cache
def _reports() -> list[Report]:
    mask = np.zeros((68, 90), np.uint8)
    clear = verdict_from_mask(mask, "texture", "m/1", None)
    mask[10:20, 30:50] = 255
    said = (clear, verdict_from_mask(mask, "texture", "m/1", 1.5), _UNKNOWN)
    return [Report(n, n, _T + n, 3.5, verdict, 4.25) for n, verdict in enumerate(said, 1)]


@cache
def _datagrams() -> list[Files]:
    said = [encode_v1(report.verdict) for report in _reports()]
    made = (*(data for data in said if data is not None), *map(encode_v2, _reports()))
    return [{"datagram": data} for data in made]


def _read_datagram(path: Path) -> object:
    """Decode and show it as `tokt listen --json` does."""
    return json.dumps(decode(path.read_bytes()[:_MAX_DATAGRAM]), allow_nan=False)


@cache
def _mavlink() -> list[Files]:
    """A second of an autopilot: a serial port's bytes."""
    common = mavlink_dialect()
    said = (
        common.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3),
        common.MAVLink_global_position_int_message(5, 1, 1, 0, -3000, 0, 0, 0, 9000),
        common.MAVLink_vfr_hud_message(0.0, 0.0, 90, 0, -3.0, 0.0),
        common.MAVLink_attitude_message(5, 0.1, 0.1, 0, 0, 0, 0),
        common.MAVLink_system_time_message(1_461_149_301_000_000, 5),
        common.MAVLink_statustext_message(4, b"leak detected"),
    )
    sender = common.MAVLink(None, 1, 1)
    packed = [bytes(message.pack(sender, version)) for message in said for version in (False, True)]
    return [{"link": b"".join(packed)}]


_NMEA = b"""$GPGGA,120000.00,6326.802,N,01025.200,E,1,08,1.0,0.0,M,,M,,*66
$GNRMC,120000,A,3354.0,S,07030.0,W,0.0,0.0,200416,,,A*69
$HCHDG,358.0,1.0,E,2.5,E*62
$PRDID,-1.31,7.81,047.3*58
$YXXDR,D,31.42,M,DEPTH*1C
"""


def _read_link(path: Path) -> object:
    """What comes, in pieces and at once, by whoever may be at the other end."""
    data, state = path.read_bytes(), VehicleState(SYSTEM_CLOCK)
    for whole in (False, True):
        readers = MavlinkReader((1, 196), whole, state, list), NmeaReader(state, True, whole)
        for at in range(0, len(data), 37 if whole else 300):
            for reader in readers:
                reader.heard(data[at : at + 300])
    return state.place()


@cache
def _events() -> tuple[dict[str, Any], ...]:
    file = UsedFile("c.yml", "0" * 64)
    software = {"tokt": "0.1.0", "python": "3.11.7"}
    start = RunStart("dive", "fallback", model=ModelName("m/1", "1" * 64), calibration=file)
    begun = Event(_T, "start", "begun", {**start.fields(), "software": software})
    model = Event(_T + 1, "model", "exchanged", {"label": "m/2", "sha256": "2" * 64})
    return event_line(_RUN, 0, begun), event_line(_RUN, 2, model)


@cache
def _lines() -> tuple[dict[str, Any], ...]:
    found = []
    for report in _reports():
        left = np.full((9, 9), 40, np.uint8)
        frame = Frame(report.seq, report.t or 0.0, left, None, timed=True, missed=0)
        judgement = Judgement(report.verdict, np.zeros((4, 1)), None, 0.0035)
        line = frame_line(_RUN, frame, judgement, report)
        found.append({**line, "decision_values": [[0.5], [1.5]]})
    return (*found, heartbeat_line(_RUN, Report(4, None, None, None, _UNKNOWN)))


def _lines_of(*values: Any) -> bytes:
    return b"\n".join(map(text_of, values)) + b"\n"


@cache
def _logs() -> list[Files]:
    return [{"run.events.jsonl": _lines_of(*_events()), "run.jsonl": _lines_of(*_lines())}]


@cache
def _recordings() -> list[Files]:
    start, model = _events()
    frames = [
        {**line, "judged": number, "moment": 1, "files": {"left": f"Left/t_L_{number}.png"}}
        for number, line in enumerate(_lines()[:3], 1)
    ]
    head = {"recording": RECORDING_FORMAT, "run": _RUN}
    return [{f"run/{FILE_NAME}": _lines_of(head, start, *frames[:2], model, frames[2])}]


def _log_in(folder: Path) -> Path:
    recording = folder / "run"
    return recording if recording.is_dir() else folder / "run.jsonl"


def _read_run(folder: Path) -> object:
    """What `tokt replay` reads before it judges anything."""
    return list(open_run(_log_in(folder)).frames())


def _export_run(folder: Path) -> object:
    """What `tokt replay --export` writes, read back by no one."""
    done = [
        export_log(_log_in(folder), folder / f"exported{ending}") for ending in (".csv", ".mcap")
    ]
    assert done[0].frames == done[1].frames
    return done


@cache
def _shadow_logs() -> list[Files]:
    kept = ("status", "reason", "mean", "method", "model", "health", "latency_ms")
    said = [{name: line.get(name) for name in kept} for line in _lines()[:3]]
    start = {"event": "start", "run": _RUN, "format_version": 1, "policy": "texture", "live": True}
    start["challenger"] = {"label": "c/1", "sha256": "3" * 64}
    frames = [
        {"run": _RUN, "seq": n, "frame": n, "dropped": 0, "champion": one, "challenger": one}
        for n, one in enumerate(said, 1)
    ]
    end = {"event": "end", "run": _RUN, "dropped": 1}
    return [{"shadow.jsonl": _lines_of(start, *frames, end)}]


def _read_shadow(path: Path) -> object:
    return json.dumps(read_shadow(path).to_json(), allow_nan=False)


@cache
def _pictures() -> list[Files]:
    pixels = np.random.default_rng(3).integers(0, 255, (24, 32, 3), np.uint8)
    suffixes = (".png", ".jpg", ".bmp", ".tif", ".ppm")
    return [{f"p{kind}": cv2.imencode(kind, pixels)[1].tobytes()} for kind in suffixes]


def _change_picture(files: Files, rng: Random, others: Sequence[bytes]) -> Files:
    if "p.png" in files and chance(rng, 60):
        return {"p.png": changed_png(rng.choice((files["p.png"], some_picture(rng))), rng)}
    return change_one(files, rng, others)


def _read_picture(path: Path) -> object:
    picture = read_image(path)
    assert picture.dtype == np.uint8 and picture.ndim in (2, 3) and picture.size
    return picture


@cache
def _mpegts() -> list[Files]:
    packets = transport_stream(encode(frames=20, key_every=5))
    return [{"video": b"".join(packet.data for packet in packets)}]


def _read_mpegts(path: Path) -> object:
    """As datagrams of seven packets; bytes that came in between shift them."""
    data, reader = path.read_bytes(), TransportReader()
    starts = range(0, len(data), 1316)
    try:
        return [reader.datagram(data[at : at + 1316], at * 1e-7) for at in starts]
    except StreamLostError as error:
        raise ToktError(str(error)) from None


@cache
def _multipart() -> list[Files]:
    data = cv2.imencode(".jpg", np.zeros((40, 50), np.uint8))[1].tobytes()
    heads = (b"X-Timestamp: 1.5\r\n", b"Content-Length: %d\r\n" % len(data))
    parts = (b"--b\r\n" + head + b"\r\n" + data + b"\r\n" for head in heads)
    return [{"video": b"".join(parts) * 3 + b"--b--\r\n"}]


def _read_multipart(path: Path) -> object:
    data, parts = path.read_bytes(), Parts("b")
    return [parts.feed(data[at : at + 300]) for at in range(0, len(data), 300)]


KINDS = [
    Kind("video.mpegts", _mpegts, alone(_read_mpegts), 2),
    Kind("video.multipart", _multipart, alone(_read_multipart), 4),
    Kind("datagram", _datagrams, alone(_read_datagram), 29),
    Kind("link.mavlink", _mavlink, alone(_read_link), 6),
    Kind("link.nmea", sound("link", _NMEA), alone(_read_link), 4),
    Kind("run log", _logs, _read_run, 18),
    Kind("recording", _recordings, _read_run, 9),
    Kind("exported log", _logs, _export_run, 9),
    Kind("exported recording", _recordings, _export_run, 4),
    Kind("shadow log", _shadow_logs, alone(_read_shadow), 9),
    Kind("picture", _pictures, alone(_read_picture), 19, change=_change_picture),
]
