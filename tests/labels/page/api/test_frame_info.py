"""What a mission's file of metadata says of a frame, as the page asks for it."""

import json

import cv2
import numpy as np

from tests.labels.formats.examples import foreign_ifdo


def test_frame_info(page_server, tmp_path):
    mission = tmp_path / "dive"
    (mission / "Left").mkdir(parents=True)
    for frame in (3, 7):
        picture = np.full((137, 181), 90, np.uint8)
        cv2.imwrite(str(mission / "Left" / f"dive_L_{frame}.png"), picture)
    server = page_server(mission=mission)
    assert server.get("/api/frame_info", camera="left", frame=3) == {}
    assert not server.get("/api/mission")["described"]  # pages need not ask
    server.kill()
    (mission / "ifdo.json").write_text("{")
    server.start()
    answer = server.request("GET", "/api/frame_info?camera=left&frame=3")
    assert answer.status == 400 and b"ifdo.json line 1: not JSON" in answer.body
    (mission / "ifdo.json").write_text(json.dumps(foreign_ifdo()))
    assert server.get("/api/mission")["described"]
    assert server.get("/api/frame_info", camera="left", frame=3) == {
        "time": "2016-04-20T10:00:00.250000Z",
        "latitude": 63.4,
        "longitude": 10.4,
        "depth_m": 310.5,
        "above_ground_m": 2.5,
        "heading_deg": 271.0,
    }
    assert server.get("/api/frame_info", camera="left", frame=7) == {}
    assert server.get("/api/mission")["depths"] == [[310, 311]]
    assert server.get("/api/frames_at", above=310, below=311) == {"cameras": {"left": [3]}}
    assert server.get("/api/frames_at", above=311, below=400) == {"cameras": {"left": []}}
    assert server.request("GET", "/api/frame_info?camera=left&frame=4").status == 404
