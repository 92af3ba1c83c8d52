"""Put a study's results into its page: ``python docs/make_closed_loop_page.py OUT``.

OUT is a folder of ``tokt simulate --closed-loop``. The page's tables stand between two marks; the
picture is pictures/sea_trial.jpg.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt_studies.simulation.loop.flight import PLANNERS
from tokt_studies.simulation.loop.scenes import KINDS, LoopScene, draw_scene
from tokt_studies.simulation.loop.track import Track
from tokt_studies.simulation.loop.vehicle import State
from tokt_studies.simulation.report.maps import Chart, still
from tokt_studies.simulation.report.outcome import GROUND_IN_VIEW

DOCS = Path(__file__).parent
PAGE, PICTURE = DOCS / "explanation" / "closed_loop.md", DOCS / "pictures" / "sea_trial.jpg"
BEGIN, END = "<!-- results -->\n", "<!-- end of results -->\n"
DEFAULT = "fallback"
MAPS = (
    ("tower-fallback-labview-timed-201", "the thesis's rule"),
    ("tower-fallback-sea-trial-202", "the waypoint behind the vehicle"),
    ("tower-fallback-sea-trial-201", "the waypoint behind the obstacle"),
)
HEIGHT_PX = 640
WENT_STEPS = 180
"""After so many control steps it is seen to which side it went."""


def main(out: Path) -> None:
    """Write the tables and the picture."""
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    tables = "\n".join([*about(results), "", *default_rows(results), "", *other_rows(results), ""])
    PAGE.write_text(f"{before}{BEGIN}\n{tables}\n{END}{after}", encoding="utf-8")
    if all((out / "flights" / f"{name}.npz").exists() for name, _ in MAPS):
        cv2.imwrite(str(PICTURE), picture(out, results["width"]), [cv2.IMWRITE_JPEG_QUALITY, 85])


def about(results: dict[str, Any]) -> list[str]:
    """What was flown, and with what."""
    first, last = results["seeds"]
    versions = ", ".join(results["versions"])
    model, _, sha256 = (results["model"] or "none").partition(", sha256 ")
    with_model = f" with the model {model} ({sha256[:12]})" if sha256 else ""
    return [
        f"Seeds from {first} to {last}, of frames {results['width']} pixels wide. tokt {versions} "
        f"flew them{with_model}."
    ]


def default_rows(results: dict[str, Any]) -> list[str]:
    """The default policy, scene by scene."""
    rows = [["scene", "collisions", "goal reached", "false avoidance", "least clearance", "detour"]]
    for row in results["table"]:
        if row["method"] == DEFAULT:
            clearance, detour = row["clearance_min_m"], row["detour_median"]
            rates = (rate(row, name) for name in ("collided", "reached", "false_avoidance"))
            clearance = "" if clearance is None else f"{clearance:.2f} m"
            detour = "" if detour is None else f"{detour:.0%}"
            rows.append([KINDS[row["scene"]].title, *rates, clearance, detour])
    return table(rows)


def table(rows: list[list[str]]) -> list[str]:
    """Lines of Markdown; the first row is the head."""
    head, *below = [f"| {' | '.join(row)} |" for row in rows]
    return [head, "|" + "---|" * len(rows[0]), *below]


def rate(row: dict[str, Any], name: str) -> str:
    """How often, of how many runs, and the bounds in percent; - where it cannot happen."""
    if name == "false_avoidance" and row["scene"] in GROUND_IN_VIEW:
        return "-"
    low, high = 100 * row[f"{name}_low"], 100 * row[f"{name}_high"]
    return f"{row[name]} of {row['runs']} ({low:.1f} to {high:.1f} %)"


def other_rows(results: dict[str, Any]) -> list[str]:
    """The other methods: collisions, goals reached and false avoidance of so many runs."""
    rows = {(row["scene"], row["method"]): row for row in results["table"]}
    methods = [name for name in dict.fromkeys(name for _, name in rows) if name != DEFAULT]
    lines = [["collided, arrived, falsely avoided", *methods]]
    for scene in dict.fromkeys(name for name, _ in rows):
        cells = [shown(rows.get((scene, method))) for method in methods]
        if any(cells):
            lines.append([KINDS[scene].title, *cells])
    return table(lines) if methods else []


def shown(row: dict[str, Any] | None) -> str:
    """Counts of one scene and method."""
    if row is None:
        return ""
    false = "-" if row["scene"] in GROUND_IN_VIEW else row["false_avoidance"]
    return f"{row['collided']}, {row['reached']}, {false} of {row['runs']}"


def picture(out: Path, width: int) -> Any:
    """The sea trial's fault: maps side by side."""
    maps = []
    for name, words in MAPS:
        track, _ = Track.from_bytes((out / "flights" / f"{name}.npz").read_bytes())
        scene = draw_scene(track.scene, track.seed, width)
        chart = replace(Chart.of(scene, 0.0), waypoint=first_waypoint(track, scene))
        drawn = cv2.imdecode(np.frombuffer(still(track, chart), np.uint8), cv2.IMREAD_COLOR)
        size = (round(drawn.shape[1] * HEIGHT_PX / len(drawn)), HEIGHT_PX)
        small = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
        small = cv2.copyMakeBorder(small, 30, 0, 0, 0, cv2.BORDER_CONSTANT, value=(255,) * 3)
        cv2.putText(small, words, (60, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (40, 40, 40), 1, 16)
        maps.append(small)
    return np.hstack(maps)


def first_waypoint(track: Track, scene: LoopScene) -> Any:
    """Where the first avoidance led to: the rule's place there, on the side that it went to."""
    planner = PLANNERS[track.method.removeprefix(f"{DEFAULT}-")]
    step = int(np.searchsorted(track.t_s, track.avoidances_s[0] - 1e-6))
    at, later = track.position[step], track.position[step + WENT_STEPS]
    nav = State(at, float(track.heading[step]), np.zeros(3))
    sides = [planner(scene).target(0.0, nav, {"status": 1, "x": x}).position for x in (-1, 1)]
    return max(sides, key=lambda place: (place - at) @ (later - at))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
