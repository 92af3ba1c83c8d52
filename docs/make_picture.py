"""Make pictures/demo.jpg from a finished demo: ``python docs/make_picture.py demo-out``."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

from tokt.features.frames.mission import open_mission
from tokt.inference.policy.policy import judge_image
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.taxonomy import Taxonomy
from tokt.models.store.store import Store
from tokt.training.evaluation.pictures import beside_labels


def main(out: Path) -> None:
    """Draw the held-back frames with the most and the fewest obstacle patches, side by side."""
    mission, taxonomy = open_mission(out / "synthetic"), Taxonomy.load()
    records = read_label_csv(out / "synthetic" / "labels.csv", taxonomy)
    bundle = Store(out / "store").active()
    entries = [json.loads(line) for line in (out / "replay.jsonl").read_text().splitlines()]
    seen = sorted((e for e in entries if e["status"] == 1), key=lambda e: e["mean"])
    views = []
    for entry in (seen[len(seen) // 4], seen[-len(seen) // 3]):
        image = mission.read(entry["frame"])
        said = [record for record in records if record.frame == entry["frame"]]
        judged = judge_image(bundle, image)
        values, verdict = judged.decision_values, judged.verdict
        views.append(beside_labels(bundle, image, values, verdict, said, taxonomy))
    picture = cv2.resize(np.vstack(views), None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    path = Path(__file__).parent / "pictures" / "demo.jpg"
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 82])


main(Path(sys.argv[1]))
