"""The demo's report: one HTML file that needs no other."""

from __future__ import annotations

import platform
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from tokt import __version__
from tokt.features.common import atomic
from tokt.features.frames.mission import LEFT, format_frames
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.verdict import OBSTACLE, STATUS_MEAN_THRESHOLD
from tokt.labels.merge import merge_annotators
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE
from tokt.training.evaluation import plots
from tokt.training.evaluation.pictures import beside_labels, draw, jpeg_uri
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .demo_run import DemoRun

_PICTURES = 8


def _labels_by_frame(run: DemoRun) -> dict[int, list[LabelRecord]]:
    merged = merge_annotators(record for record in run.records if record.camera == LEFT)
    found: dict[int, list[LabelRecord]] = {}
    for record in merged.records:
        found.setdefault(record.frame, []).append(record)
    return found


def _obstacle_counts(run: DemoRun, labels: dict[int, list[LabelRecord]]) -> list[int]:
    """Labelled obstacle patches of each held-back frame."""
    return [
        sum(
            record.label != UNSURE and run.taxonomy.is_obstacle(str(record.label))
            for record in labels.get(frame, [])
        )
        for frame in run.held_frames
    ]


def _chosen_frames(run: DemoRun, counts: list[int]) -> list[tuple[int, str]]:
    """Frames worth a look: false alarms and misses of the champion, then an even sample."""
    scored = run.scored[run.champion]
    judged = list(zip(scored.frames, scored.status, counts, strict=True))
    false = [frame for frame, status, labelled in judged if status == OBSTACLE and not labelled]
    missed = [frame for frame, status, labelled in judged if status != OBSTACLE and labelled]
    chosen = [(frame, "status 1 without a labelled obstacle") for frame in false[:2]]
    chosen += [(frame, "an obstacle is labelled, but no status 1") for frame in missed[:2]]
    rest = [frame for frame in scored.frames if frame not in {frame for frame, _ in chosen}]
    sampled = evenly_spaced(rest, max(0, _PICTURES - len(chosen)))
    chosen += [(frame, "evenly sampled") for frame in sampled]
    return sorted(chosen)


def _pictures(run: DemoRun, labels: dict[int, list[LabelRecord]]) -> list[dict[str, Any]]:
    bundle, scored = run.bundles[run.champion], run.scored[run.champion]
    said = dict(zip(scored.frames, zip(scored.values, scored.verdicts, strict=True), strict=True))
    pictures = []
    for frame, why in _chosen_frames(run, _obstacle_counts(run, labels)):
        image = run.mission.read(frame, LEFT)
        values, verdict = said[frame]
        records = labels.get(frame, [])
        judged = beside_labels(bundle, image, values, verdict, records, run.taxonomy)
        pictures.append(
            {
                "frame": frame,
                "why": why,
                "uri": jpeg_uri(draw(judged, bundle.grid)),
                "status": verdict.status,
                "mean": verdict.mean,
                "x": verdict.x,
                "y": verdict.y,
                "health": verdict.health,
            }
        )
    return pictures


def _curves(run: DemoRun, labels: dict[int, list[LabelRecord]]) -> dict[str, str]:
    means = {name: scored.mean for name, scored in run.scored.items()}
    counts = _obstacle_counts(run, labels)
    timeline = plots.mean_by_frame(run.held_frames, means, counts, STATUS_MEAN_THRESHOLD)
    curves = {}
    for name, trained in run.trained.items():
        tested = trained.held_out.fold >= 0
        dataset = trained.request.dataset
        truth = np.asarray(trained.model.obstacle, bool)[dataset.targets()[tested]]
        curves[name] = truth, trained.model.obstacle_score(trained.held_out.values[tested])
    held_out = plots.precision_recall(curves)
    champion = run.evaluations[run.champion]["patch"]["confusion"]
    latency = [entry["latency_ms"] for entry in run.replay.log] if run.replay else []
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


def _rows(run: DemoRun) -> list[dict[str, Any]]:
    return [
        {
            "name": run.bundles[name].label,
            "champion": name == run.champion,
            "extractor": trained.request.extractor_name,
            "features": trained.request.extractor.dim,
            "preset": trained.request.settings.preset,
            "cv": trained.metrics,
            "held": run.evaluations[name],
            "megabytes": len(run.bundles[name].data) / 1e6,
        }
        for name, trained in run.trained.items()
    ]


def write_report(path: Path, run: DemoRun, bundle_file: Path) -> None:
    """Write the report of a demo.

    Parameters
    ----------
    path : Path
    run : DemoRun
        A demo that has gone through all its stages.
    bundle_file : Path
        The exported champion.
    """
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["figure"] = lambda value: "–" if value is None else f"{value:.3f}"
    environment.filters["first"] = _first_words
    template = environment.from_string(
        resources.files(__package__).joinpath("report.html").read_text("utf-8")
    )
    labels = _labels_by_frame(run)
    champion, trained = run.bundles[run.champion], run.trained[run.champion]
    latency = np.array([entry["latency_ms"] for entry in run.replay.log]) if run.replay else None
    html = template.render(
        run=run,
        champion=champion,
        provenance=champion.content.provenance,
        point=champion.operating_point,
        cross_validated=trained.metrics,
        bundle_file=bundle_file.name,
        rows=_rows(run),
        pictures=_pictures(run, labels),
        plots=_curves(run, labels),
        train_frames=format_frames(run.train_frames),
        held_frames=format_frames(run.held_frames),
        latency_median_ms=None if latency is None else float(np.median(latency)),
        latency_p95_ms=None if latency is None else float(np.percentile(latency, 95)),
        datagrams=[d.decode("ascii") for d in (run.replay.datagrams if run.replay else [])][-3:],
        kernels=KERNELS.name,
        machine=f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        version=__version__,
    )
    atomic.write_text(path, html)
