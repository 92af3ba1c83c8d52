"""`tokt run` and `tokt listen` as processes of their own."""

import json
import signal
import socket

import cv2
import numpy as np
import pytest

from tests.calls import Ran, call_tokt, refused, run_python, succeeds
from tests.inference.live import start_tokt
from tests.inference.logged_runs import lines
from tests.inference.policy import named_object
from tests.models.conftest import small_content
from tests.waiting import MAX_S, until
from tokt.features.extractors.water import Colour
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.models.bundle.bundle import bundle_bytes, read_bundle
from tokt.models.store.store import Store

CHANGING = {"t", "latency_ms", "age_ms", "run"}


def run(*arguments: object) -> Ran:
    """A run that ends well, in this process."""
    return succeeds("run", *arguments)


def run_of(folder, bundle, port, *more: object) -> Ran:
    """A run of policy texture over a folder, told to a port of this computer."""
    given = ("--source", folder, "--bundle", bundle, "--policy", "texture")
    return run(*given, "--udp", f"127.0.0.1:{port}", *more)


def same_to_the_bit(log) -> int:
    """How many of a log's frames a replay judges alike."""
    return json.loads(succeeds("replay", log, "--json").out)["same_to_the_bit"]


def test_a_run_sends_logs_and_sums_up(make_mission, bundle_file, receiver, tmp_path):
    folder = make_mission([[], [(4, 4)], [], [(2, 7)]])
    port = receiver.getsockname()[1]
    log = tmp_path / "log.jsonl"
    done = run(
        *("--bundle", bundle_file, "--source", folder, "--frames", "1-3"),
        *("--udp", f"127.0.0.1:{port}", "--log", log, "--json"),
    )
    summary = json.loads(done.out)
    assert (summary["frames"], summary["obstacle"], summary["sent"]) == (3, 1, 3)
    rule, _, sums = done.err.splitlines()
    assert rule == "model noise/7: status 1 with 1 patch over the threshold, in one frame"
    assert "3 frames" in sums
    statuses = [receiver.recv(4096).split(b",")[1].strip() for _ in range(3)]
    assert statuses == [b"0", b"1", b"0"]
    assert [line["frame"] for line in lines(log)] == [1, 2, 3]
    assert {line["model"] for line in lines(log)} == {"noise/7"}
    assert "no fallback" in lines(log)[0]["health"]


def test_a_run_ends_with_the_reasons_of_what_is_unknown(make_mission, bundle_file):
    folder = make_mission([[], [], [(4, 4)]])
    for path in sorted((folder / "Left").iterdir())[:2]:
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), np.full_like(picture, 255))
    done = run("--bundle", bundle_file, "--source", folder, "--policy", "texture")
    sums, unknown, advice = done.err.splitlines()[-3:]
    assert "1 obstacle, 0 clear, 2 unknown" in sums and unknown == "unknown: 2 saturated"
    assert advice == f"  saturated: {Reason.SATURATED.meaning} {Reason.SATURATED.advice}"


def test_a_store_s_active_model_runs_to_two_receivers(
    make_mission, bundle_file, receiver, tmp_path
):
    Store(tmp_path / "store").deploy(read_bundle(bundle_file))
    address = f"127.0.0.1:{receiver.getsockname()[1]}"
    run(
        *("--store", tmp_path / "store", "--source", make_mission([[(4, 4)]])),
        *("--udp", address, "--udp", address, "--format", "v2", "--policy", "texture"),
    )
    both = [json.loads(receiver.recv(4096)) for _ in range(2)]
    assert both[0] == both[1]
    assert both[0]["model"] == "noise/7" and both[0]["health"] == "ok" and both[0]["status"] == 1


def test_an_anchor_is_sent_as_v2_and_logged_and_replayed(
    make_mission, bundle_file, receiver, tmp_path
):
    folder, log = make_mission([[(6, 2), (6, 3)], []]), tmp_path / "log.jsonl"
    port = receiver.getsockname()[1]
    run_of(folder, bundle_file, port, "--format", "v2", "--anchor", "0.02", "--log", log)
    sent = [decode(receiver.recv(4096)) for _ in range(2)]
    assert (sent[0]["anchor_x"], sent[0]["anchor_size"]) == pytest.approx((-0.4, 0.0), abs=0.01)
    assert sent[0]["anchor_y"] > 0.25
    assert [sent[1][f"anchor_{name}"] for name in ("x", "y", "size")] == [None] * 3
    assert [line["anchor_x"] for line in lines(log)] == [fields["anchor_x"] for fields in sent]
    assert same_to_the_bit(log) == 2
    events = tmp_path / "log.events.jsonl"
    start_event = json.loads(events.read_text().splitlines()[0])
    assert start_event["anchor"] == 0.02
    events.write_text(json.dumps({**start_event, "anchor": 0.04}) + "\n")
    other = call_tokt("replay", log)
    assert other.code == 1 and "anchor_size" in other.out


def test_a_part_that_is_not_at_work_is_said_and_no_part_of_a_replay(
    make_mission, bundle_file, receiver, tmp_path
):
    pytest.importorskip("prometheus_client")
    folder, log = make_mission([[(4, 4)], [], [(2, 7)]]), tmp_path / "log.jsonl"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        about = ("--format", "v2", "--log", log, "--metrics", port)
        done = run_of(folder, bundle_file, receiver.getsockname()[1], *about)
    assert f"--metrics is not working: metrics cannot be served on 127.0.0.1:{port}" in done.err
    health = [decode(receiver.recv(4096))["health"] for _ in range(3)]
    assert all("without --metrics: metrics cannot be served" in words for words in health)
    assert [line["health"] for line in lines(log)] == health
    assert same_to_the_bit(log) == 3


@pytest.mark.parametrize("policy", ["fallback", "either"])
def test_a_run_without_its_calibration_is_replayed(make_mission, bundle_file, tmp_path, policy):
    folder, log = make_mission([[(4, 4)], [], [(2, 7)]]), tmp_path / "log.jsonl"
    lacks = ("--no-strict", "--calibration", tmp_path / "none.yml", "--policy", policy)
    run("--source", folder, "--bundle", bundle_file, "--log", log, *lacks)
    judged = [line for line in lines(log) if line["frame"] is not None]
    assert [line["status"] for line in judged] == [1, 0, 1]
    assert all("without --calibration" in line["health"] for line in judged)
    assert same_to_the_bit(log) == 3


def test_an_object_is_named_by_a_box_in_a_frame_of_the_source(
    make_mission, bundle_file, receiver, tmp_path
):
    folder, log = make_mission([[]] * 5), tmp_path / "log.jsonl"
    for number in range(1, 6):
        seen = named_object.picture(named_object.own(120 + 4 * number), seed=number)
        cv2.imwrite(str(folder / "Left" / f"t_L_{number}.jpg"), seen)
    told = ("--format", "v2", "--anchor-from", "2:98,90,60,84", "--log", log)
    run_of(folder, bundle_file, receiver.getsockname()[1], *told)
    sent = [decode(receiver.recv(4096)) for _ in range(5)]
    assert [fields["anchor"] for fields in sent] == [*["searching"] * 2, *["held"] * 3]
    assert [fields["anchor_x"] for fields in sent[:2]] == [None] * 2
    assert sent[4]["anchor_x"] == pytest.approx(2 * 140 / 360 - 1, abs=0.02)
    assert sent[4]["anchor_size"] == pytest.approx(0.0, abs=0.03)
    assert same_to_the_bit(log) == 5


def test_a_file_s_run_under_a_watchdog_is_that_of_its_command_line(
    make_mission, bundle_file, closed_port, tmp_path
):
    """The command line wins: its bundle over the file's store, which is not there."""
    folder, log = make_mission([[], [(4, 4)]]), tmp_path / "log.jsonl"
    file = tmp_path / "dive.toml"
    file.write_text(
        f"[source]\nsource = {json.dumps(str(folder))}\n[model]\nstore = 'none'\n"
        f"[outputs]\nudp = ['127.0.0.1:{closed_port}']\n"
        "[monitoring]\nwatchdog = true\njson = true\n"
        f"[recording]\nlog = {json.dumps(str(log))}\nlog-keep = 3\n"
    )
    done = run_python(
        *("-m", "tokt", "run", "--config", file, "--bundle", bundle_file, "--policy", "texture")
    )
    assert done.returncode == 0 and json.loads(done.stdout)["obstacle"] == 1, done.stderr
    (start_event,) = lines(tmp_path / "log.events.jsonl")
    assert start_event["source"] == str(folder) and start_event["models_from"] == str(bundle_file)
    plain = tmp_path / "plain.jsonl"
    run_of(folder, bundle_file, closed_port, "--log", plain)
    (same,) = lines(tmp_path / "plain.events.jsonl")
    assert list(same) == list(start_event)
    assert same == {**start_event, "t": same["t"], "run": same["run"]}


def test_a_model_that_looks_at_colours_is_refused_where_the_source_says_gray(
    make_mission, tmp_path
):
    file = tmp_path / "colour.json"
    file.write_text(json.dumps(Colour(9).spec))
    content = small_content(extractor=f"spec:{file}", channels=(3,))
    (tmp_path / "colour.tokt").write_bytes(bundle_bytes(content))
    asked = ["run", "--source", make_mission([[]]), "--bundle", tmp_path / "colour.tokt"]
    words = "model small/0 looks at colours: not with --pixel-format Mono8\n"
    refused(words, *asked, "--pixel-format", "Mono8")
    succeeds(*asked)


def test_ctrl_c_ends_cleanly(make_mission, bundle_file, closed_port, tmp_path):
    log = tmp_path / "log.jsonl"
    process = start_tokt(
        *("run", "--bundle", bundle_file, "--source", make_mission([[(1, 1)]] * 100)),
        *("--udp", f"127.0.0.1:{closed_port}", "--rate", "10", "--log", log, "--json"),
    )
    until(lambda: log.is_file() and len(log.read_bytes().splitlines()) >= 3)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=MAX_S)
    assert process.returncode == 0, err
    said = err.splitlines()
    assert len(said) == 3 and "tokt run on" in said[1] and "frames in" in said[2]
    assert log.read_bytes().endswith(b"\n")
    assert json.loads(out)["frames"] == len(lines(log)) < 100


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bundle", "B", "--store", "S"], "not both"),
        (["--model", "waters", "--store", "S"], "not both"),
        ([], "needs a model"),
        (["--bundle", "none.tokt"], "none.tokt"),
        (["--policy", "disparity"], "needs a stereo calibration"),
        (["--bundle", "B", "--policy", "disparity"], "leave out --store/--bundle/--model"),
        (["--bundle", "B", "--frames", "1-3"], "has frames 1, not 2-3"),
        (["--bundle", "B", "--policy", "magic"], "unknown policy"),
        (["--bundle", "B", "--format", "v3"], "unknown format"),
        (["--bundle", "B", "--anchor", "2", "--format", "v2"], "0.01 to 0.9, not 2"),
        (["--bundle", "B", "--log-values"], "--log-values is of no use without --log"),
        (["--bundle", "B", "--log-keep", "20"], "no use without --log or --shadow-log"),
        (["--bundle", "B", "--record-mb", "5"], "no use without --record"),
        (["--bundle", "B", "--mavlink-unknown", "message"], "no use without --mavlink"),
        (["--bundle", "B", "--nmea-dpt"], "no use without --nmea"),
        (["--bundle", "B", "--nmea", "COM3"], "--nmea is of no use without a receiver of v2"),
        (["--bundle", "B", "--nmea", "udpout:h:9", "--format", "v2"], "--nmea only listens"),
        (["--bundle", "B", "--shadow-log", "x"], "no use without --shadow"),
        (
            ["--shadow", "B", "--shadow-log", "a.events.jsonl", "--log", "a.jsonl"],
            "--shadow-log names a file that --log writes",
        ),
        (["--bundle", "B", "--anchor", "0.1"], "--anchor is of no use without a receiver of v2"),
        (["--bundle", "B", "--anchor-from", "1:2,2,50,50"], "--anchor-from is of no use without"),
        (["--bundle", "B", "--format", "v2", "--anchor-from", "1:2,2"], "FRAME:X,Y,W,H: an image"),
        (["--bundle", "B", "--format", "v2", "--anchor-from", "9:2,2,50,50"], "frame 9"),
        (["--bundle", "B", "--format", "v2", "--anchor-from", "1:2,2,50,9"], "cannot be held"),
        (
            ["--bundle", "B", "--format", "v2", "--anchor-from", "1:2,2,50,50", "--anchor", "0.5"],
            "--anchor 0.5: in this box the object is held at 0.013 to 0.051",
        ),
        (["--bundle", "B", "--stale", "0.5"], "--stale is for live cameras, or recorded"),
        (["--bundle", "B", "--ptp"], "--ptp is for live cameras"),
        (["--bundle", "B", "--source", "pymba:0", "--rate", "3"], "--rate is for recorded"),
        (
            ["--policy", "disparity", "--fixed-boundary"],
            "--fixed-boundary is for the policies that",
        ),
        (["--bundle", "B", "--calibration", "none.yml"], "does not exist"),
        (["--bundle", "B", "--source", "pymba:0"], "no Vimba library"),
    ],
)
def test_mistakes_are_one_line(make_mission, bundle_file, arguments, message):
    given = [str(bundle_file) if word == "B" else word for word in arguments]
    said = refused(message, "run", "--source", make_mission([[]]), *given)
    assert len(said.splitlines()) == 1


def test_threads_change_no_verdict(make_mission, bundle_file, tmp_path, closed_port):
    folder = make_mission([[], [(4, 4), (9, 9)], [(0, 0)]])
    logs = []
    for threads in (1, 2):
        log = tmp_path / f"{threads}.jsonl"
        kept = ("--log", log, "--log-values")
        run_of(folder, bundle_file, closed_port, "--threads", threads, *kept)
        logs.append([{key: line[key] for key in line.keys() - CHANGING} for line in lines(log)])
    assert logs[0] == logs[1] and [line["status"] for line in logs[0]] == [0, 1, 1]


def test_raw_camera_frames_are_judged_as_their_pictures(
    draw_frame, bundle_file, tmp_path, closed_port
):
    """A gray scene has the same mosaic in every pattern: its own pixels."""
    folder = tmp_path / "raw"
    folder.mkdir()
    for number, patches in enumerate([[], [(4, 4)]], 1):
        cv2.imwrite(str(folder / f"{number}.png"), draw_frame(patches, number))
    cv2.imwrite(str(folder / "3.png"), cv2.merge([draw_frame([(4, 4)])] * 3))
    log = tmp_path / "log.jsonl"
    run(
        *("--bundle", bundle_file, "--source", folder, "--pixel-format", "BayerRG8"),
        *("--udp", f"127.0.0.1:{closed_port}", "--log", log),
    )
    found = lines(log)
    assert [line["status"] for line in found] == [0, 1, -1]
    assert "the image is in colour" in found[2]["health"]


@pytest.mark.mission
def test_a_run_without_its_model_goes_on_with_disparity(
    mission, calibration_path, tmp_path, closed_port
):
    broken = tmp_path / "broken.tokt"
    broken.write_bytes(b"PK not really")
    log = tmp_path / "log.jsonl"
    run(
        *("--bundle", broken, "--source", mission, "--frames", "30,180"),
        *("--calibration", calibration_path, "--log", log, "--udp", f"127.0.0.1:{closed_port}"),
    )
    ocean, tower = lines(log)
    assert (ocean["status"], tower["status"]) == (0, 1)
    assert tower["method"] == "disparity" and tower["distance_m"] == pytest.approx(2.7, abs=0.1)
    assert tower["health"].startswith("texture: no model")


def test_listen_has_its_port_alone_and_shows_each_datagram_up_to_a_count(closed_port):
    process = start_tokt("listen", "--port", closed_port, "--count", "3", "--json")
    assert "listening" in process.stderr.readline()
    refused("cannot listen", "listen", "--port", closed_port)
    v1 = b"status : , 1  ,Xpos : ,-120,  Ypos : , -35 , meanValue : ,12.3456789012"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (v1, b"\x1b[2J garbage", v1):
            sender.sendto(data, ("127.0.0.1", closed_port))
    out, _ = process.communicate(timeout=MAX_S)
    shown = [json.loads(line) for line in out.splitlines()]
    assert process.returncode == 0 and len(shown) == 3
    assert shown[0]["x"] == -120 and "not a tokt datagram" in shown[1]["error"]


def test_listen_tells_silence_without_being_asked(closed_port):
    """Of v1 silence is all that unknown is."""
    process = start_tokt("listen", "--port", closed_port)
    assert "nobody yet  silent for" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=MAX_S) == 0


def test_listen_ends_quietly_when_its_reader_does(closed_port, monkeypatch):
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)  # as a user's shell has it
    process = start_tokt("listen", "--port", closed_port)
    process.stderr.readline()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"one", ("127.0.0.1", closed_port))
        assert "not a tokt datagram" in process.stdout.readline()
        process.stdout.close()
        sender.sendto(b"two", ("127.0.0.1", closed_port))
    assert process.wait(timeout=MAX_S) == 0
    assert process.stderr.read() == ""
