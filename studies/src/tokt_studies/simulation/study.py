"""A whole study: the model, all runs, what they came to, and the folder that tells it.

The folder keeps each run as it is flown. A study that was cut short goes on where it stopped, and
one of other scenes, methods or seeds joins what is there: the report is of all runs in the folder.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd

from tokt import __version__
from tokt.features.common import atomic
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.labels.formats.options import Progress
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.training.options import Notice
from tokt.training.parallel import mapped
from tokt_studies.simulation.loop.flight import METHODS, NONE, OURS, PLANNERS, fly, uses_model
from tokt_studies.simulation.loop.scenes import ANCHOR, KINDS, draw_scene
from tokt_studies.simulation.loop.track import Track
from tokt_studies.simulation.rendering.synthetic_mission import check_width
from tokt_studies.simulation.report.maps import Chart
from tokt_studies.simulation.report.outcome import GROUND_IN_VIEW, FlightOutcome, outcome_of, table
from tokt_studies.simulation.report.report import write_report

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
MODEL_FILE, FLIGHTS = "model.tokt", "flights"


@dataclass(frozen=True)
class Study:
    """The study that is asked for: a run of each scene and method for each seed."""

    out: Path  # new folder, or one that holds a study
    scenes: Sequence[str]
    methods: Sequence[str]
    seeds: Sequence[int]
    width: int  # of the frames, px
    model: Path | None  # the bundle; None: the folder's, or trains one, if a method uses it
    jobs: int  # runs at a time; -1 for one a core
    planner: str = "tokt"  # of `PLANNERS`


@dataclass(frozen=True)
class Studied:
    """The outcomes of all runs in a study's folder, and the model that was flown."""

    study: Study
    outcomes: list[FlightOutcome]
    model: str | None  # the bundle's ``name/version`` with its hash; None where no method uses one
    versions: list[str]  # of tokt, that flew them

    @property
    def table(self) -> pd.DataFrame:
        """A row for each scene and method."""
        return table(self.outcomes)

    @property
    def seeds(self) -> tuple[int, int]:
        """The first and the last seed."""
        seeds = [outcome.seed for outcome in self.outcomes]
        return min(seeds), max(seeds)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form: the table and every run."""
        rows = json.loads(self.table.to_json(orient="records"))
        return {
            "format": RESULTS_FORMAT,
            "model": self.model,
            "versions": self.versions,
            "width": self.study.width,
            "seeds": list(self.seeds),
            "tuned_on_seeds_from": FIRST_TUNING_SEED,
            "table": rows,
            "runs": [outcome.to_json() for outcome in self.outcomes],
        }

    def split_words(self) -> str:
        """Which seeds these are, and which ones were looked at before."""
        first, last = self.seeds
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
            f"{row.scene:9} {row.method:10} collisions {row.collided:3d} of {row.runs}, "
            f"arrived {row.reached:3d}, false avoidance in "
            f"{'-' if row.scene in GROUND_IN_VIEW else row.false_avoidance:>3}"
            for row in self.table.itertuples(index=False)
        ]
        return [*lines, self.split_words(), f"report: {self.study.out / 'report.html'}"]


def fly_study(study: Study, progress: Progress, say: Notice) -> Studied:
    """Fly the runs that the folder lacks, and write its ``results.json`` and `write_report`.

    Raises ToktError if something asked for does not exist, or the folder is another's.
    """
    _check(study)
    with os_errors_as(f"cannot write in {study.out}"):
        (study.out / FLIGHTS).mkdir(parents=True, exist_ok=True)
    bundle = _bundle(study, progress, say)
    asked = product(study.scenes, study.methods, study.seeds)
    missing = [flight for flight in asked if not _file(study, *flight).exists()]
    flown = mapped(partial(_fly, study), missing, study.jobs)
    for _ in progress(flown, len(missing), "closed loop"):
        pass
    tracks, versions = _flown(study)
    model = None if bundle is None else f"{bundle.label}, sha256 {bundle.sha256}"
    studied = Studied(study, [outcome_of(track) for track in tracks], model, versions)
    results = json.dumps(studied.to_json(), indent=1, allow_nan=False)
    atomic.write_text(study.out / "results.json", results + "\n")
    # What moves is on the map where it was when the vehicle was nearest. One scene at a time: each
    # has 11 MB of textures.
    seen = ((draw_scene(one.scene, one.seed, study.width), one.t_s[one.nearest]) for one in tracks)
    write_report(study.out, tracks, [Chart.of(*each) for each in seen], _about(studied))
    return studied


def _file(study: Study, scene: str, method: str, seed: int) -> Path:
    """Where a run is kept."""
    return study.out / FLIGHTS / f"{scene}-{_label(method, study.planner)}-{seed}.npz"


def _label(method: str, planner: str) -> str:
    """What a method is called in tables; who listens to nothing has no planner."""
    return method if planner == OURS or method == NONE else f"{method}-{planner}"


def _flown(study: Study) -> tuple[list[Track], list[str]]:
    """All runs of the folder in the order of scenes, methods and seeds, and who flew them."""
    read = [Track.from_bytes(file.read_bytes()) for file in (study.out / FLIGHTS).glob("*.npz")]
    for track, about in read:
        if about["width"] != study.width:
            words = f"{track.scene}, seed {track.seed}, is of frames {about['width']} px wide"
            raise ToktError(f"{study.out}: {words}, not {study.width}; choose another folder")
    scenes, methods = list(KINDS), [_label(m, p) for p in PLANNERS for m in METHODS]
    tracks = [track for track, _ in read]
    tracks.sort(key=lambda one: (scenes.index(one.scene), methods.index(one.method), one.seed))
    return tracks, sorted({about["version"] for _, about in read})


def _check(study: Study) -> None:
    """Find what is wrong before minutes of rendering."""
    if study.out.exists() and not (study.out / FLIGHTS).is_dir():
        raise ToktError(f"{study.out} is there already; give the name of a new folder")
    check_width(study.width)
    if study.model is not None and not any(map(uses_model, study.methods)):
        raise ToktError(f"no model is used by {', '.join(study.methods)}: leave it out")
    if study.model is not None:
        read_bundle(study.model)
    for what, asked, known in (
        ("scene", study.scenes, tuple(KINDS)),
        ("method", study.methods, METHODS),
        ("planner", [study.planner], tuple(PLANNERS)),
    ):
        for name in asked:
            if name not in known:
                raise ToktError(f"unknown {what} {name!r} (choose from {', '.join(known)})")
        if not asked or len(set(asked)) < len(asked):
            raise ToktError(f"name each {what} once, and at least one")
    if ANCHOR in study.scenes and study.planner != OURS:
        raise ToktError(f"scene {ANCHOR} has a planner of its own: leave out --planner")


def _fly(study: Study, flight: tuple[str, str, int]) -> None:
    scene, method, seed = flight
    model = study.out / MODEL_FILE if uses_model(method) else None
    track = fly(draw_scene(scene, seed, study.width), method, model, study.planner)
    track = replace(track, method=_label(method, study.planner))
    about = {"width": study.width, "version": __version__}
    atomic.write_bytes(_file(study, *flight), track.to_bytes(about))


def _bundle(study: Study, progress: Progress, say: Notice) -> Bundle | None:
    """The model that flies, kept in the study's folder; none is trained that nobody uses."""
    path = study.out / MODEL_FILE
    if study.model is not None:
        bundle = read_bundle(study.model)
        if path.exists() and path.read_bytes() != bundle.data:
            raise ToktError(f"{study.out} was flown with another model; choose another folder")
        atomic.write_bytes(path, bundle.data)
        return bundle
    if path.exists():
        return read_bundle(path)
    if not any(map(uses_model, study.methods)):
        return None
    return train_default_model(path, study.width, progress, say, study.jobs)


def _about(studied: Studied) -> list[str]:
    """What stands over the report's table."""
    study = studied.study
    model = "No model." if studied.model is None else f"Model {studied.model}."
    versions = ", ".join(studied.versions)
    return [
        f"{model} Frames {study.width} px wide. Flown by tokt {versions}.",
        studied.split_words(),
        f"Each verdict comes from a process of tokt run by UDP v2; {NONE} is a planner that does "
        "not listen. Time is simulated: however busy the machine is, a seed is the same run.",
        "The water is rendered, and the vehicle knows exactly where it is: neither holds at sea.",
    ]
