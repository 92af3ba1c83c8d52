"""The measurements of network video in small: what they count, and that they see damage."""

import json
import sys
from dataclasses import replace

import pytest

from tests.inference.sources.video.senders import Film, needs_gst, needs_gst_rtsp
from tests.load.video import run as video_run
from tests.load.video.captures import count_captures, judged_share
from tokt.inference.sources.video.access_units import Depacketizer

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux programs")


@needs_gst
@needs_gst_rtsp
def test_a_short_look_at_video(run_load, tmp_path, monkeypatch):
    short = replace(video_run.QUICK, captures=10, streams=2, seconds=3.0, pictures=135)
    short = replace(short, film=Film(size=(640, 480), kbit=3000))
    monkeypatch.setattr(video_run, "QUICK", short)
    ran = run_load("video", "--quick", "--json", "--out", tmp_path / "out")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert found["captures"]["streams"] == 10 and found["captures"]["whole"] > 10
    assert found["live"]["streams"] == 2 and found["live"]["sent"] == 60
    damaged = found["captures"]["damaged"] + found["live"]["damaged"]
    assert damaged == 0 and ran.code == 0
    assert [share["codec"] for share in found["share"]] == ["h264", "h265"]
    ways = {each["way"]: each for each in found["latency"]}
    assert len(ways) == 6 and all(each["median_ms"] > 0 for each in ways.values())
    whole = [read for name, read in found["readers"] if name.endswith("0.0% lost")]
    assert [read["damaged"] for read in whole] == [0, 0, 0]
    assert all(read["pictures"] for read in whole)
    lossy = dict(found["readers"])["tokt, 1.0% lost"]
    assert lossy["damaged"] == 0
    assert json.loads((tmp_path / "out" / "video.json").read_text()) == found


def test_an_unknown_part_is_refused(run_load):
    ran = run_load("video", "--part", "audio")
    assert ran.code == 2 and "no part 'audio': captures" in ran.err


def test_a_reader_that_joins_what_is_left_is_found_out(monkeypatch):
    assert count_captures(15).damaged == 0
    add = Depacketizer.add
    monkeypatch.setattr(Depacketizer, "add", lambda self, packet, lost: add(self, packet, False))
    counted = count_captures(15)
    assert counted.damaged > 0 and counted.worst[0] < 15


def test_where_nothing_is_lost_everything_is_judged():
    share = judged_share(200_000, 0.0, 1, (96, 64), 30, "h264")
    assert (share.whole, share.intact) == (1.0, 1.0)
    lossy = judged_share(200_000, 0.1, 3, (96, 64), 30, "h264")
    assert lossy.whole < lossy.intact < 1.0
