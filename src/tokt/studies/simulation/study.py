"""A whole study: the model, all runs, what they came to, and the folder that tells it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.studies.simulation.loop.flight import METHODS, NONE, WIDTH
from tokt.studies.simulation.loop.flights import FIRST_TUNING_SEED, RunsRequest, fly_all, uses_model
from tokt.studies.simulation.loop.scenes import KINDS, draw_scene
from tokt.studies.simulation.rendering.synthetic_mission import check_width
from tokt.studies.simulation.report.chart import Chart
from tokt.studies.simulation.report.outcome import FlightOutcome, outcome_of, table
from tokt.studies.simulation.report.outlines import outlines
from tokt.studies.simulation.report.report import Flown, write_report

from .default_model import train_default_model

RESULTS_FORMAT = 1
"""Version of results.json; a change of meaning or a key taken away raises it."""
MODEL_FILE = "model.tokt"

Progress = Callable[..., Any]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Study:
    """The study that is asked for.

    Parameters
    ----------
    out : Path
        New folder.
    scenes, methods : sequence of str
    seeds : sequence of int
        A run of each scene and method for each.
    width : int
        Of the frames, in pixels.
    model : Path or None
        The bundle; None trains one, if one of the methods uses it.
    jobs : int
        Runs at a time; -1 for one a core.
    """

    out: Path
    scenes: Sequence[str] = tuple(KINDS)
    methods: Sequence[str] = METHODS
    seeds: Sequence[int] = (1,)
    width: int = WIDTH
    model: Path | None = None
    jobs: int = -1


@dataclass(frozen=True)
class Studied:
    """The outcomes of a study.

    Parameters
    ----------
    outcomes : list of FlightOutcome
        By scene, method and seed, as asked.
    model : str or None
        ``name/version`` of the bundle that was flown, with its hash; None where no method uses one.
    """

    study: Study
    outcomes: list[FlightOutcome]
    model: str | None

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


def fly_study(study: Study, progress: Progress, say: Say) -> Studied:
    """Fly all runs and write ``model.tokt``, ``results.json`` and what `write_report` writes.

    Raises
    ------
    ToktError
        If something asked for does not exist, or the folder is there already.
    """
    request = _checked(study)
    with atomic.new_folder(study.out) as folder:
        bundle = _bundle(study, folder, progress, say)
        tracks = fly_all(request(folder / MODEL_FILE), progress)
        outcomes = [outcome_of(track) for track in tracks]
        model = None if bundle is None else f"{bundle.label}, sha256 {bundle.sha256}"
        studied = Studied(study, outcomes, model)
        results = json.dumps(studied.to_json(), indent=1, allow_nan=False)
        (folder / "results.json").write_text(results + "\n", encoding="utf-8")
        charts = {
            (name, seed): _chart(name, seed, study.width)
            for name in study.scenes
            for seed in study.seeds
        }
        flown = [
            Flown(track, charts[track.scene, track.seed], outcome)
            for track, outcome in zip(tracks, outcomes, strict=True)
        ]
        write_report(folder, outcomes, flown, _about(studied))
    return studied


def _checked(study: Study) -> Callable[[Path], RunsRequest]:
    """Find what is wrong before minutes of rendering."""
    if study.out.exists():
        raise ToktError(f"{study.out} is there already; give the name of a new folder")
    check_width(study.width)
    if study.model is not None and not any(map(uses_model, study.methods)):
        raise ToktError(f"no model is used by {', '.join(study.methods)}: leave it out")
    if study.jobs == 0:
        raise ToktError("jobs: a number of processes, or -1 for one a core; not 0")

    def request(model: Path) -> RunsRequest:
        return RunsRequest(study.scenes, study.methods, study.seeds, study.width, model, study.jobs)

    request(study.out)
    return request


def _bundle(study: Study, folder: Path, progress: Progress, say: Say) -> Bundle | None:
    """The model that flies, also in the study's folder; none is trained that nobody uses."""
    if not any(map(uses_model, study.methods)):
        return None
    path = folder / MODEL_FILE
    if study.model is None:
        return train_default_model(path, study.width, progress, say, study.jobs)
    bundle = read_bundle(study.model)
    path.write_bytes(bundle.data)
    return bundle


def _chart(name: str, seed: int, width: int) -> Chart:
    scene = draw_scene(name, seed, width)
    return Chart(outlines(scene.world), scene.goal, scene.current_m_s)


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
