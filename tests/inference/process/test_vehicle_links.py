"""`tokt run` beside a vehicle, whose place stands in datagrams, log and recording."""

import json
import os
import socket
import sys
from pathlib import Path
from subprocess import DEVNULL, Popen

import pytest

from tests.calls import succeeds
from tests.inference.links.test_autopilot import ATTITUDE, BEAT, packed, position
from tests.inference.links.test_nmea import sentence
from tests.inference.live import bound_socket, start_tokt
from tests.inference.logged_runs import lines, write_lines
from tests.waiting import MAX_S, until

pytest.importorskip("pymavlink")

PLACE = {"depth_m": 31.42, "heading_deg": 271.5, "lat_deg": 63.4467, "lon_deg": 10.42}
LATER = {*PLACE, "place_age_ms", "roll_deg", "pitch_deg", "vehicle_t", "captured_t"}
MAVPROXY = Path(os.environ.get("TOKT_MAVPROXY", Path(__file__).parents[3] / "build" / "mavproxy"))


def frames_of(address, folder, bundle_file, receiver, *more, rate=20):
    """A run over a link, as a process."""
    return start_tokt(
        *("run", "--bundle", bundle_file, "--source", folder, "--rate", rate),
        *("--policy", "texture", "--camera-fov-deg", "60", "--mavlink", address),
        *("--udp", f"v2@127.0.0.1:{receiver.getsockname()[1]}", *more),
    )


def until_placed(receiver, speak):
    """Let the vehicle speak until a datagram has its place; that datagram."""
    receiver.settimeout(0.05)

    def placed():
        speak()
        try:
            fields = json.loads(receiver.recv(4096))
        except TimeoutError:
            return None
        return fields if fields["depth_m"] is not None else None

    return until(placed)


def test_the_place_of_an_autopilot_over_tcp_is_kept(make_mission, bundle_file, receiver, tmp_path):
    folder = make_mission([[(4, 4)] if n % 4 > 1 else [] for n in range(100)])
    log = tmp_path / "log.jsonl"
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(MAX_S)
        address = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        kept = ("--log", log, "--record", tmp_path / "kept")
        program = frames_of(address, folder, bundle_file, receiver, *kept)
        channel, _ = server.accept()
        with channel:
            speak = lambda: channel.sendall(packed(position()) + packed(ATTITUDE))  # noqa: E731
            fields = until_placed(receiver, speak)
            assert {name: fields[name] for name in PLACE} == PLACE
            assert [until_placed(receiver, speak)["status"] for _ in range(4)].count(1) >= 1
    program.terminate()
    _, said = program.communicate(timeout=MAX_S)
    assert program.returncode == 0, said
    placed = [line for line in lines(log) if line["depth_m"] is not None]
    assert {name: placed[-1][name] for name in PLACE} == PLACE
    assert (placed[-1]["roll_deg"], placed[-1]["pitch_deg"]) == (-7.8, 1.3)
    assert 0 <= placed[-1]["place_age_ms"] <= 2000
    (recording,) = (tmp_path / "kept").glob("run-*")
    assert lines(recording / "recording.jsonl")[-1].keys() >= LATER
    # A replay compares what was judged; a log and a recording of yesterday have no place.
    for path, place in ((log, log), (recording / "recording.jsonl", recording)):
        for older in (False, True):
            if older:
                found = [{k: v for k, v in line.items() if k not in LATER} for line in lines(path)]
                write_lines(path, found)
            done = succeeds("replay", place, "--bundle", bundle_file, "--json")
            assert json.loads(done.out)["same"], done.out


def test_the_place_of_nmea_sensors(make_mission, bundle_file, receiver, closed_port):
    folder = make_mission([[]] * 100)
    port, here = receiver.getsockname()[1], ("127.0.0.1", closed_port)
    program = start_tokt(
        *("run", "--bundle", bundle_file, "--source", folder, "--rate", "20", "--nmea-dpt"),
        *("--nmea", f"udpin:127.0.0.1:{closed_port}", "--udp", f"v2@127.0.0.1:{port}"),
    )
    with bound_socket() as sensor:
        fields = until_placed(receiver, lambda: sensor.sendto(sentence("IIDPT,31.42,0.0"), here))
    program.terminate()
    program.communicate(timeout=MAX_S)
    assert fields["depth_m"] == 31.42


@pytest.mark.skipif(not (MAVPROXY / "MAVProxy").is_dir(), reason=f"no MAVProxy in {MAVPROXY}")
def test_words_and_place_pass_mavproxy(make_mission, bundle_file, receiver, tmp_path):
    """It passes what it hears on an --out to the vehicle, and the vehicle's to every --out."""
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    folder = make_mission([[(4, 4)]] * 400)
    with bound_socket() as one, bound_socket() as other:
        master, ours = (f"127.0.0.1:{each.getsockname()[1]}" for each in (one, other))
    with bound_socket() as autopilot:
        autopilot.settimeout(0.01)
        command = [
            *(sys.executable, "-m", "MAVProxy.mavproxy", f"--master=udpin:{master}"),
            *(f"--out=udpin:{ours}", "--daemon", "--non-interactive"),
            *(f"--state-basedir={tmp_path}", "--force-connected"),
        ]
        paths = f"{MAVPROXY}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        environment = {**os.environ, "PYTHONPATH": paths, "HOME": str(tmp_path)}
        router = Popen(command, env=environment, stdout=DEVNULL, stderr=DEVNULL, cwd=tmp_path)
        program = frames_of(f"udpout:{ours}", folder, bundle_file, receiver, rate=5)
        parser, texts = common.MAVLink(None), set()
        parser.robust_parsing = True
        host, port = master.split(":")

        def speak():
            assert router.poll() is None, "MAVProxy has ended"
            for message in (BEAT, position()):
                autopilot.sendto(packed(message), (host, int(port)))
            try:
                for message in parser.parse_buffer(autopilot.recv(4096)) or []:
                    texts.add(getattr(message, "text", ""))
            except TimeoutError:
                pass

        try:
            fields = until_placed(receiver, speak)
            until(lambda: speak() or "tokt: obstacle ahead" in texts, lambda: texts)
        finally:
            for process in (program, router):
                process.terminate()
                process.wait(MAX_S)
        assert {name: fields[name] for name in PLACE} == PLACE
