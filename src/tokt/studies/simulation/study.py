"""A whole study: the model, all runs, what they came to, and the folder that tells it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.labels.formats.options import Progress
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.studies.simulation.loop.flight import METHODS, NONE, fly, uses_model
from tokt.studies.simulation.loop.scenes import KINDS, draw_scene
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.rendering.synthetic_mission import check_width
from tokt.studies.simulation.report.maps import Chart
from tokt.studies.simulation.report.outcome import FlightOutcome, outcome_of, table
from tokt.studies.simulation.report.report import write_report
from tokt.training.options import Notice
from tokt.training.parallel import mapped

from .default_model import train_default_model

FIRST_TUNING_SEED = 1000
"""Planner and scenes were worked out on seeds from here on; those below are for what is reported.

Seeds 1 to 100 of the tower scene led to the model's sequences of open water, and 101 to 200 were
reported with version 0.1.0 (closed_loop.md).
"""
REPORTED_SEEDS = range(201, 301)
"""Frozen with the scenes, before the planner was tuned on them."""
RESULTS_FORMAT = 1
"""Version of results.json; a change of meaning or a key taken away raises it."""
MODEL_FILE = "model.tokt"


@dataclass(frozen=True)
class Study:
    """The study that is asked for: a run of each scene and method for each seed."""

    out: Path  # new folder
    scenes: Sequence[str]
    methods: Sequence[str]
    seeds: Sequence[int]
    width: int  # of the frames, px
    model: Path | None  # the bundle; None trains one, if one of the methods uses it
    jobs: int  # runs at a time; -1 for one a core


@dataclass(frozen=True)
class Studied:
    """The outcomes of a study, by scene, method and seed as asked, and the model that was flown."""

    study: Study
    outcomes: list[FlightOutcome]
    model: str | None  # the bundle's ``name/version`` with its hash; None where no method uses one

    @property
    def table(self) -> pd.DataFrame:
        """A row for each scene and method."""
        return table(self.outcomes)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form: the table and every run."""
        rows = json.loads(self.table.to_json(orient="records"))
        return {
            "format": RESULTS_FORMAT,
            "model": self.model,
            "width": self.study.width,
            "seeds": [min(self.study.seeds), max(self.study.seeds)],
            "tuned_on_seeds_from": FIRST_TUNING_SEED,
            "table": rows,
            "runs": [outcome.to_json() for outcome in self.outcomes],
        }

    def split_words(self) -> str:
        """Which seeds these are, and which ones were looked at before."""
        first, last = min(self.study.seeds), max(self.study.seeds)
        words = (
            f"Seeds {first} to {last}; planner and scenes were worked out on seeds from "
            f"{FIRST_TUNING_SEED} on."
        )
        if last >= FIRST_TUNING_SEED:
            words += " Some of these are among them: no test."
        return words

    def words(self) -> list[str]:
        """Lines for people: one for each scene and method, the seeds, and where the report is."""
        lines = [
            f"{row.scene:8} {row.method:10} collisions {row.collided:3d} of {row.runs}, "
            f"arrived {row.reached:3d}, false avoidance in {row.false_avoidance:3d}"
            for row in self.table.itertuples(index=False)
        ]
        return [*lines, self.split_words(), f"report: {self.study.out / 'report.html'}"]


def fly_study(study: Study, progress: Progress, say: Notice) -> Studied:
    """Fly all runs and write ``model.tokt``, ``results.json`` and what `write_report` writes.

    Raises ToktError if something asked for does not exist, or the folder is there already.
    """
    _check(study)
    with atomic.new_folder(study.out) as folder:
        bundle = _bundle(study, folder, progress, say)
        flights = list(product(study.scenes, study.methods, study.seeds))
        flown = mapped(partial(_fly, study.width, folder / MODEL_FILE), flights, study.jobs)
        tracks = list(progress(flown, len(flights), "closed loop"))
        model = None if bundle is None else f"{bundle.label}, sha256 {bundle.sha256}"
        studied = Studied(study, [outcome_of(track) for track in tracks], model)
        results = json.dumps(studied.to_json(), indent=1, allow_nan=False)
        (folder / "results.json").write_text(results + "\n", encoding="utf-8")
        where = [_chart(track, study.width) for track in tracks]
        write_report(folder, tracks, where, _about(studied))
    return studied


def _check(study: Study) -> None:
    """Find what is wrong before minutes of rendering."""
    if study.out.exists():
        raise ToktError(f"{study.out} is there already; give the name of a new folder")
    check_width(study.width)
    if study.model is not None and not any(map(uses_model, study.methods)):
        raise ToktError(f"no model is used by {', '.join(study.methods)}: leave it out")
    for what, asked, known in (
        ("scene", study.scenes, tuple(KINDS)),
        ("method", study.methods, METHODS),
    ):
        for name in asked:
            if name not in known:
                raise ToktError(f"unknown {what} {name!r} (choose from {', '.join(known)})")
        if not asked or len(set(asked)) < len(asked):
            raise ToktError(f"name each {what} once, and at least one")


def _fly(width: int, model: Path, flight: tuple[str, str, int]) -> Track:
    scene, method, seed = flight
    return fly(draw_scene(scene, seed, width), method, model if uses_model(method) else None)


def _chart(track: Track, width: int) -> Chart:
    """The map under a track, with what moves where it was when the vehicle was nearest."""
    scene = draw_scene(track.scene, track.seed, width)
    return Chart.of(scene, float(track.t_s[track.nearest]))


def _bundle(study: Study, folder: Path, progress: Progress, say: Notice) -> Bundle | None:
    """The model that flies, also in the study's folder; none is trained that nobody uses."""
    if not any(map(uses_model, study.methods)):
        return None
    path = folder / MODEL_FILE
    if study.model is None:
        return train_default_model(path, study.width, progress, say, study.jobs)
    bundle = read_bundle(study.model)
    path.write_bytes(bundle.data)
    return bundle


def _about(studied: Studied) -> list[str]:
    """What stands over the report's table."""
    study = studied.study
    trained = "; trained on rendered missions of other seeds" if study.model is None else ""
    model = "No model." if studied.model is None else f"Model {studied.model}{trained}."
    return [
        f"{model} Frames {study.width} px wide.",
        studied.split_words(),
        f"Each verdict comes from a process of tokt run by UDP v2; {NONE} is a planner that does "
        "not listen. Time is simulated: however busy the machine is, a seed is the same run.",
        "The water is rendered, and the vehicle knows exactly where it is: neither holds at sea.",
    ]
