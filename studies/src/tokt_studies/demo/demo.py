"""The whole chain in one run: labels, dataset, training, registry, bundle, store, runtime, UDP."""

import json
import shutil
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, Mission, format_frames, open_mission
from tokt.inference.outputs.udp import decode
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.formats.options import Progress
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.registry.registry import Registry
from tokt.models.store.store import Store
from tokt.training.compare.bootstrap import compare_f1
from tokt.training.datasets import folds, mission_source
from tokt.training.datasets.dataset import write_dataset
from tokt.training.datasets.dive_positions import dive_positions
from tokt.training.datasets.split import Split
from tokt.training.evaluation.evaluate import evaluate_missions, score_mission
from tokt.training.fitting.classifier import decision_values
from tokt.training.fitting.presets import extractor_for, settings_named
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import TrainRequest, fit_and_measure
from tokt.training.options import Notice
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.speed.stamped_receiver import StampedReceiver

from .report import DemoRun, write_report

_MARK = "made-by-tokt-demo"
_HOLD_BACK_EVERY = 3
_MIN_BLOCKS = 12
_CANDIDATES = (("tower-lbp", "lbp", "best"), ("tower-haralick", "haralick", "best"))
_BASELINES = (("thesis-lbp", "lbp", "thesis"), ("thesis-haralick", "haralick", "thesis"))


def _empty_folder(out: Path, *kept: Path | None) -> None:
    """Make `out` an empty folder; only a folder that an earlier demo made is emptied."""
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / _MARK).is_file())):
        raise ToktError(f"{out} is not a folder that a demo made; choose another with --out")
    for path in kept:
        if path is not None and path.resolve().is_relative_to(out.resolve()):
            raise ToktError(f"{path} lies in {out}, which the demo empties; choose another --out")
    if out.is_dir():
        shutil.rmtree(out)
    atomic.write_text(out / _MARK, "This folder is emptied by the next tokt demo.\n")


def block_rule(records: list[LabelRecord]) -> tuple[int, int]:
    """Frames a block and frames of embargo: the usual ones, or less for a short mission."""
    labelled = len({record.frame for record in records})
    block = min(folds.BLOCK_FRAMES, max(2, labelled // _MIN_BLOCKS))
    return block, folds.embargo_of(block)


def hold_back(
    mission: Mission,
    records: list[LabelRecord],
    taxonomy: Taxonomy,
    block_frames: int,
    embargo_frames: int,
) -> tuple[list[int], list[int]]:
    """Split the labelled left frames of a mission: blocks to learn from, blocks to replay.

    Every third block of consecutive frames is held back; frames within the embargo of a
    held-back one are in neither part.
    """
    is_obstacle, positions = taxonomy.is_obstacle, dive_positions(mission).of_frame
    rows = [
        (
            r.mission,
            r.frame,
            positions[r.frame],
            folds.block_of(r.mission, positions[r.frame], block_frames),
            is_obstacle(str(r.label)),
        )
        for r in records
        if r.label != UNSURE and r.camera == LEFT
    ]
    table = pd.DataFrame(rows, columns=["mission", "frame", "position", "group", "obstacle"])
    targets = table.obstacle.to_numpy(np.int64)
    fold = folds.every_nth_block(table, targets, _HOLD_BACK_EVERY, embargo_frames)
    frames = table.frame.to_numpy()
    return sorted(set(frames[fold.train].tolist())), sorted(set(frames[fold.test].tolist()))


def _check_given(mission: Path, labels: Path) -> Path:
    """Find what is wrong with a user's mission or labels before anything is deleted; its path."""
    opened, taxonomy = open_mission(mission), Taxonomy.load()
    read = read_label_csv(labels, taxonomy)
    records, _ = mission_source.labels_of_mission(opened, read, DEFAULT_GRID, only=True)
    hold_back(opened, records, taxonomy, *block_rule(records))
    return opened.path


def _prepare(out: Path, mission: Path, labels: Path | None, say: Notice) -> DemoRun:
    opened, taxonomy = open_mission(mission), Taxonomy.load()
    say("-- import labels")
    read = read_label_csv(labels or mission / "labels.csv", taxonomy)
    with LabelStore(out / "workspace" / "labels.db") as store:
        store.add(read)
        records, remark = mission_source.labels_of_mission(
            opened, store.current(), DEFAULT_GRID, only=True
        )
    if remark:
        say(f"note: {remark}")
    block, embargo = block_rule(records)
    train_frames, held = hold_back(opened, records, taxonomy, block, embargo)
    return DemoRun(opened, records, taxonomy, block, embargo, train_frames, held)


def _train_all(run: DemoRun, workspace: Path, registry: Registry, progress: Progress) -> None:
    for name, extractor, preset in (*_CANDIDATES, *_BASELINES):
        chosen, settings = extractor_for(extractor, preset), settings_named(preset)
        split = Split(folds.FOLDS, run.embargo_frames)
        request = TrainRequest(run.dataset, name, chosen, extractor, settings, split)
        run.trained[name] = fit_and_measure(request, workspace / "cache", progress)
        log_and_register(run.trained[name], registry)
        run.bundles[name] = registry.bundle(name)


def _choose(run: DemoRun, registry: Registry) -> None:
    """Compare the candidates on cross-validated predictions only; the better one is champion."""
    first, second = (run.trained[name] for name, _, _ in _CANDIDATES)
    truth = np.asarray(first.model.obstacle, bool)[run.dataset.targets()]
    said = [t.model.obstacle_patches(t.held_out.values) for t in (first, second)]
    run.difference = compare_f1(truth, said[0], said[1], run.dataset.patches.group.to_numpy())
    better = first if run.difference.difference >= 0 else second
    run.champion = better.request.name
    registry.set_alias(run.champion, "champion")


def _replay(run: DemoRun, store: Path, log: Path) -> None:
    """Run `tokt run` on the held-back frames, listen to what it sends, and hold both together."""
    with closing(StampedReceiver()) as receiver:
        command = [sys.executable, "-m", "tokt", "run", "--store", str(store)]
        command += ["--source", str(run.mission.path), "--frames", format_frames(run.held_frames)]
        command += ["--policy", "texture", "--udp", f"127.0.0.1:{receiver.port}", "--format", "v1"]
        command += ["--log", str(log), "--log-values"]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode != 0:
            last = (ended.stderr.strip().splitlines() or ["no message"])[-1]
            raise ToktError(f"the runtime ended with code {ended.returncode}: {last}")
        run.datagrams = [datagram for _, datagram in receiver.heard()]
    run.log = [json.loads(line) for line in log.read_text("utf-8").splitlines()]
    run.skew = _skew(run)
    run.disagreements = _disagreements(run)


def _skew(run: DemoRun) -> float:
    """How far the runtime's decision values are from scikit-learn's, at the most."""
    trained = run.trained[run.champion]
    worst = 0.0
    for entry in run.log:
        if entry["decision_values"] is None:
            continue
        image = run.mission.read(entry["frame"], LEFT)
        described = trained.request.extractor.describe(image, run.dataset.grid)
        expected = decision_values(trained.pipeline, described)
        worst = max(worst, float(np.abs(expected - np.asarray(entry["decision_values"])).max()))
    return worst


def _disagreements(run: DemoRun) -> int:
    sent = [entry for entry in run.log if entry["status"] != -1]
    wrong = abs(len(sent) - len(run.datagrams))
    for entry, datagram in zip(sent, run.datagrams, strict=False):
        heard = decode(datagram)
        same = all(heard[key] == entry[key] for key in ("status", "x", "y"))
        wrong += not same or abs(heard["mean"] - entry["mean"]) > 1e-9 * max(1, entry["mean"])
    return wrong


def run_demo(
    out: Path,
    mission: Path | None,
    labels: Path | None,
    frames: int,
    width: int,
    progress: Progress,
    say: Notice,
) -> dict[str, Any]:
    """Run the whole chain, and write workspace, store, log and ``report.html`` into `out`.

    Of a real mission with its label file, or of one that is rendered, of `frames` stereo pairs
    `width` pixels wide. Returns the figures of the report. Raises ToktError if the mission or its
    labels cannot be used.
    """
    place = None
    if mission is not None and labels is not None:
        place = _check_given(mission, labels)
    _empty_folder(out, place, labels)
    start = time.perf_counter()
    if rendered := mission is None:
        say("-- render a mission")
        mission = out / "synthetic"
        simulate_mission(mission, n_frames=frames, width=width, progress=progress)
    run = _prepare(out, mission, labels, say)
    run.rendered = rendered
    name = "render a mission, import labels" if rendered else "import labels"
    run.seconds[name] = time.perf_counter() - start
    workspace, store = out / "workspace", Store(out / "store")
    registry = Registry(workspace, create=True, own=True)
    labelled, learnt = [mission_source.LabelledMission(run.mission, run.records)], run.train_frames
    with run.stage("build the dataset", say):
        plan, _ = mission_source.plan_from_missions(
            "demo", "binary", labelled, run.taxonomy, frames=learnt, block_frames=run.block_frames
        )
        run.dataset = write_dataset(plan, workspace / "datasets", progress)
    with run.stage("train and register", say):
        _train_all(run, workspace, registry, progress)
    with run.stage("compare, choose the champion, export, deploy", say):
        _choose(run, registry)
        champion = registry.bundle(f"{run.champion}@champion")
        bundle_file = out / f"{champion.name}-{champion.version}.tokt"
        atomic.write_bytes(bundle_file, champion.data)
        store.deploy(champion, "tokt demo")
    with run.stage("replay the held-back frames through the runtime", say):
        _replay(run, store.path, out / "replay.jsonl")
    with run.stage("score all models on the held-back frames", say):
        for name, bundle in run.bundles.items():
            scored = score_mission(bundle, run.mission, progress, run.held_frames)
            run.scored[name] = scored
            run.evaluations[name] = evaluate_missions(
                bundle, labelled, run.taxonomy, progress, scored=scored
            )
    say("-- write the report")
    write_report(out / "report.html", run, bundle_file)
    return _result(run, bundle_file, out)


def _result(run: DemoRun, bundle_file: Path, out: Path) -> dict[str, Any]:
    return {
        "report": str(out / "report.html"),
        "bundle": str(bundle_file),
        "mission": run.mission.name,
        "rendered": run.rendered,
        "split": {
            "block_frames": run.block_frames,
            "embargo_frames": run.embargo_frames,
            "train_frames": format_frames(run.train_frames),
            "held_back_frames": format_frames(run.held_frames),
        },
        "champion": run.champion,
        "comparison": asdict(run.difference),
        "cross_validation": {name: trained.metrics for name, trained in run.trained.items()},
        "held_back": run.evaluations,
        "replay": {
            "frames": len(run.log),
            "datagrams": len(run.datagrams),
            "unknown": run.unknown,
            "disagreements": run.disagreements,
            "max_abs_difference_of_decision_values": run.skew,
        },
        "seconds": run.seconds,
    }
