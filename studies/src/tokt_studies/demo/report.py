"""The findings of a demo, and its report: one HTML file that needs no other."""

import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tokt import __version__
from tokt.features.common import atomic
from tokt.features.frames.mission import LEFT, Mission, format_frames
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.verdict import OBSTACLE, STATUS_MEAN_THRESHOLD
from tokt.labels.merge import merge_annotators
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.bundle.bundle import Bundle
from tokt.training.compare.bootstrap import Difference
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.evaluation import plots
from tokt.training.evaluation.evaluate import ScoredMission
from tokt.training.evaluation.pictures import beside_labels, jpeg_uri
from tokt.training.evaluation.report import report_page
from tokt.training.fitting.train import Trained
from tokt.training.options import Notice
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

_PICTURES = 8


@dataclass
class DemoRun:
    """Everything a demo found, for its report; what has no default is there from the start."""

    mission: Mission
    records: list[LabelRecord]  # all labels of it
    taxonomy: Taxonomy
    block_frames: int  # how the mission is cut, and the gap between parts
    embargo_frames: int
    train_frames: list[int]  # labelled frames learnt from, and held back
    held_frames: list[int]
    seconds: dict[str, float] = field(default_factory=dict)  # wall time of each stage
    trained: dict[str, Trained] = field(default_factory=dict)
    bundles: dict[str, Bundle] = field(default_factory=dict)
    scored: dict[str, ScoredMission] = field(default_factory=dict)
    evaluations: dict[str, dict[str, Any]] = field(default_factory=dict)
    rendered: bool = False
    dataset: DatasetVersion = field(init=False)
    difference: Difference = field(init=False)
    champion: str = field(init=False)
    log: list[dict[str, Any]] = field(init=False)  # of the held-back frames, with decision values
    datagrams: list[bytes] = field(init=False)  # what was sent (v1), as they arrived
    skew: float = field(init=False)  # largest difference from training's decision values
    # Datagrams that do not say what the log says, and verdicts that never arrived.
    disagreements: int = field(init=False)

    @property
    def unknown(self) -> int:
        """Replayed frames that the runtime could not judge."""
        return sum(entry["status"] == -1 for entry in self.log)

    @contextmanager
    def stage(self, name: str, say: Notice) -> Iterator[None]:
        """Time one stage and say when it begins."""
        say(f"-- {name}")
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def _labels_by_frame(run: DemoRun) -> dict[int, list[LabelRecord]]:
    merged = merge_annotators(record for record in run.records if record.camera == LEFT)
    found: dict[int, list[LabelRecord]] = {}
    for record in merged.records:
        found.setdefault(record.frame, []).append(record)
    return found


def _obstacle_counts(run: DemoRun, labels: dict[int, list[LabelRecord]]) -> list[int]:
    """Labelled obstacle patches of each held-back frame."""
    said = [[str(record.label) for record in labels.get(frame, [])] for frame in run.held_frames]
    return [sum(x != UNSURE and run.taxonomy.is_obstacle(x) for x in here) for here in said]


def _chosen_frames(run: DemoRun, counts: list[int]) -> dict[int, str]:
    """Frames worth a look: false alarms and misses of the champion, then an even sample."""
    scored = run.scored[run.champion]
    judged = list(zip(scored.frames, scored.status, counts, strict=True))
    false = [frame for frame, status, labelled in judged if status == OBSTACLE and not labelled]
    missed = [frame for frame, status, labelled in judged if status != OBSTACLE and labelled]
    chosen = dict.fromkeys(false[:2], "status 1 without a labelled obstacle")
    chosen |= dict.fromkeys(missed[:2], "an obstacle is labelled, but no status 1")
    rest = [frame for frame in scored.frames if frame not in chosen]
    sampled = evenly_spaced(rest, max(0, _PICTURES - len(chosen)))
    chosen |= dict.fromkeys(sampled, "evenly sampled")
    # Obstacles first: a report that begins with black water looks as if nothing worked.
    labelled = dict(zip(scored.frames, counts, strict=True))
    return dict(sorted(chosen.items(), key=lambda item: (not labelled[item[0]], item[0])))


def _pictures(run: DemoRun, labels: dict[int, list[LabelRecord]]) -> list[dict[str, Any]]:
    bundle, scored = run.bundles[run.champion], run.scored[run.champion]
    said = dict(zip(scored.frames, zip(scored.values, scored.verdicts, strict=True), strict=True))
    pictures = []
    for frame, why in _chosen_frames(run, _obstacle_counts(run, labels)).items():
        image = run.mission.read(frame, LEFT)
        values, verdict = said[frame]
        drawn = beside_labels(bundle, image, values, verdict, labels.get(frame, []), run.taxonomy)
        pictures.append({"frame": frame, "why": why, "uri": jpeg_uri(drawn), "verdict": verdict})
    return pictures


def _curves(run: DemoRun, labels: dict[int, list[LabelRecord]]) -> dict[str, str]:
    means = {name: scored.mean for name, scored in run.scored.items()}
    counts = _obstacle_counts(run, labels)
    timeline = plots.mean_by_frame(run.held_frames, means, counts, STATUS_MEAN_THRESHOLD)
    curves = {}
    for name, trained in run.trained.items():
        tested = trained.held_out.fold >= 0
        truth = np.asarray(trained.model.obstacle, bool)[run.dataset.targets()[tested]]
        curves[name] = truth, trained.model.obstacle_score(trained.held_out.values[tested])
    held_out = plots.precision_recall(curves)
    champion = run.evaluations[run.champion]["patch"]["confusion"]
    latency = [entry["latency_ms"] for entry in run.log]
    return {
        "timeline": plots.data_uri(timeline),
        "precision_recall": plots.data_uri(held_out),
        "confusion": plots.data_uri(plots.confusion(champion)),
        "timings": plots.data_uri(plots.timings(run.seconds, latency)),
    }


def _first_words(first: int | dict[str, int | None] | None) -> str:
    """A first detection, or those of several missions."""
    found = list(first.values()) if isinstance(first, dict) else [first]
    return ", ".join("none" if frame is None else str(frame) for frame in found) or "none"


def write_report(path: Path, run: DemoRun, bundle_file: Path) -> None:
    """Write the report of a demo that has gone through all its stages, its champion exported."""
    labels = _labels_by_frame(run)
    html = report_page(
        __package__,
        {"first": _first_words, "numbers": format_frames},
        run=run,
        bundle_file=bundle_file.name,
        pictures=_pictures(run, labels),
        plots=_curves(run, labels),
        latency_ms=np.percentile([entry["latency_ms"] for entry in run.log], (50, 95)).tolist(),
        kernels=KERNELS.name,
        machine=f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        version=__version__,
    )
    atomic.write_text(path, html)
