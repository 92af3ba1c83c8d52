"""Search a dataset for its best extractor, and train and register the winner."""

import hashlib
import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError, naming
from tokt.features.extractors.extractor import build_extractor
from tokt.models.registry.registration import RegisteredVersion
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.feature_cache import feature_key
from tokt.training.datasets.split import Split
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import TrainRequest, fit_and_measure
from tokt.training.parallel import mapped, software

from .mlflow_runs import SearchRuns
from .score import HOW, RULE, BlockConfusion, Rank, honest_score, ranked, winner
from .space import Space, Trial
from .state import SearchState, opened_state, read_finished, write_json
from .trial import TrialOutcome, TrialTask, part_of, run_task

_TRAINING = Path(__file__).parents[1]
_SCORED_BY = (".", "datasets", "evaluation", "fitting", "search")
_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class Budget:
    """A limit on the trials begun in one run; None for no limit."""

    seconds: float | None = None
    trials: int | None = None


def budget_from(text: str | None) -> Budget:
    """Read ``30m``, ``2h``, ``90s`` (time) or ``12`` (trials); ToktError if it is neither."""
    if text is None:
        return Budget()
    match = re.fullmatch(r"(\d{1,9})([smh]?)", text.strip(), re.ASCII)
    if match is None or int(match[1]) == 0:
        raise ToktError(f"budget {text!r}: write a time as 30m, 2h or 90s, or a number of trials")
    number, unit = int(match[1]), match[2]
    return Budget(seconds=number * _UNITS[unit]) if unit else Budget(trials=number)


@dataclass(frozen=True)
class SearchRequest:
    """A search to run: dataset, space, split and budget."""

    dataset: DatasetVersion
    name: str  # the winner's name in the registry
    space: Space
    split: Split
    workspace: Path
    budget: Budget = field(default_factory=Budget)  # of this run; the next does what it leaves
    nested: bool = False  # whether to measure the honest figure of the whole procedure
    fresh: bool = False  # forget what earlier runs did
    jobs: int = -1  # as in `mapped`; nothing that comes out depends on it
    dask: str | None = None  # as in `mapped`


def _code_hash() -> str:
    """Of the training code: a score of other code is not taken for one of this."""
    digest = hashlib.sha256()
    for path in sorted(path for room in _SCORED_BY for path in (_TRAINING / room).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _question(request: SearchRequest) -> dict[str, Any]:
    """Everything that can change a trial's score or the winner."""
    dataset = request.dataset
    return {
        "dataset": dataset.hash,
        "space": asdict(request.space),
        "features": [feature_key(dataset, trial.spec) for trial in request.space.trials],
        "split": request.split.parameters(),
        "rule": RULE,
        "software": software(),
        "code": _code_hash(),
    }


def search(
    request: SearchRequest, registry: Registry, progress: Callable[..., Any]
) -> dict[str, Any]:
    """Run what is left of a search, as far as the budget goes, and register the winner so far.

    The rule (`RULE`) is on disk and in the registry before the first trial is run. Returns JSON,
    also kept as ``result.json``.

    Raises ToktError if the dataset cannot be split as asked or was changed on disk, no extractor
    can be tried, the registry or the dask scheduler cannot be reached, or another process is at the
    same search.
    """
    if request.dataset.block_frames is None:
        # Frame numbers only count file names there, as `fit_and_measure` knows too.
        request = replace(request, split=replace(request.split, embargo_frames=0))
    _check(request)
    dataset, split = request.dataset, request.split
    root = request.workspace / "searches"
    with opened_state(root, _question(request), dataset.name, fresh=request.fresh) as state:
        parameters = {
            "dataset": dataset.label,
            "dataset_hash": dataset.hash,
            "trials": len(request.space.trials),
            "rule": RULE,
            **{f"setting_{key}": value for key, value in asdict(request.space.settings).items()},
            **{f"split_{key}": value for key, value in split.parameters().items()},
        }
        runs = SearchRuns(registry, state.id, f"search {request.name}", parameters)
        with runs.running():
            seconds = request.budget.seconds
            not_after = None if seconds is None else time.time() + seconds
            return _Search(request, registry, state, runs, progress, not_after).run()


def _check(request: SearchRequest) -> None:
    """Say before the work what would make it useless."""
    dataset, split = request.dataset, request.split
    dataset.check()
    split.check(dataset.patches, dataset.targets())
    if not request.nested:
        return
    for fold in split.cut(dataset.patches, dataset.targets()):
        part = part_of(dataset, fold.train)
        with naming("--nested splits each training part again"):
            split.inner.check(part.patches, part.targets())


@dataclass(frozen=True)
class _Search:
    """A search that is under way."""

    _request: SearchRequest
    _registry: Registry
    _state: SearchState
    _runs: SearchRuns
    _progress: Callable[..., Any]
    _not_after: float | None  # time (s since 1970) after which but one trial is begun
    _faults: dict[str, str] = field(default_factory=dict)  # by trial that cannot be run

    def run(self) -> dict[str, Any]:
        """Trials, then the winner by the rule, then its model."""
        whole = self._trials(self._request.space.trials)
        if not whole:
            fault = next(iter(self._faults.values()))
            raise ToktError(f"no extractor of the space can be tried on this dataset: {fault}")
        ranks = ranked(whole)
        best = winner(ranks)
        write_json(self._state.folder / "winner.json", best.trial.spec)
        honest = self._honest(whole)
        selection = (
            f"CHOSEN ON THESE FOLDS: the extractor is the winner among {len(whole)} tried on the "
            "same folds, so its figures are somewhat too good."
        )
        if honest is not None:
            selection += f" The procedure's honest score is {honest['score']:.3f}: {HOW}."
        version, metrics = self._model(best.trial, selection)
        self._runs.adopt(version.run_id)
        model = {"name": version.name, "version": version.version, "aliases": version.aliases}
        result = {
            **self._result(ranks, best, honest, selection),
            "model": model,
            "run_id": version.run_id,
            "cv": metrics,
        }
        write_json(self._state.folder / "result.json", result)
        figures = {"best_score": max(rank.score for rank in ranks), "winner_score": best.score}
        if honest is not None:
            figures["honest_score"] = honest["score"]
        tried = f"{len(whole)} of {len(self._request.space.trials)}"
        self._runs.report(figures, {"tokt.tried": tried, "tokt.winner": best.trial.name})
        return result

    def _task(self, trial: Trial, outer_fold: int | None, limited: bool) -> TrialTask:
        request = self._request
        return TrialTask(
            trial,
            request.dataset.path.resolve(),
            (request.workspace / "cache").resolve(),
            self._state.trial_file(trial.id, outer_fold).resolve(),
            request.space.settings,
            request.split,
            outer_fold,
            # However small the budget is, one trial is run.
            self._not_after if limited else None,
        )

    def _run(self, tasks: list[TrialTask], what: str) -> Iterable[TrialOutcome]:
        if not tasks:
            return ()
        outcomes = mapped(run_task, tasks, self._request.jobs, self._request.dask)
        shown: Iterable[TrialOutcome] = self._progress(outcomes, len(tasks), what)
        return shown

    def _trials(self, trials: tuple[Trial, ...]) -> dict[Trial, BlockConfusion]:
        """Run the trials that are left and the budget allows; all that are finished, in order."""
        kept = {trial: read_finished(self._state.trial_file(trial.id)) for trial in trials}
        for trial, earlier in kept.items():
            if earlier is not None:
                self._runs.log(trial, earlier)
        left = [trial for trial, earlier in kept.items() if earlier is None]
        allowed = len(left) if self._request.budget.trials is None else self._request.budget.trials
        # One that cannot be tried is not paid for, or a small budget would never get past it.
        while allowed > 0 and left:
            begun, left = left[:allowed], left[allowed:]
            tasks = [self._task(trial, None, number > 0) for number, trial in enumerate(begun)]
            for outcome in self._run(tasks, "trials"):
                trial = outcome.task.trial
                if outcome.finished is not None:
                    self._runs.log(trial, outcome.finished)
                    kept[trial] = outcome.finished
                if outcome.fault is None:
                    allowed -= 1
                else:
                    self._faults[trial.name] = outcome.fault
        return {trial: done.tally for trial, done in kept.items() if done is not None}

    def _honest(self, whole: Mapping[Trial, BlockConfusion]) -> dict[str, Any] | None:
        """The nested figure, asked for now or measured before; None while trials of it are left."""
        if len(whole) + len(self._faults) < len(self._request.space.trials):
            return None
        data = self._request.dataset
        folds = range(len(self._request.split.cut(data.patches, data.targets())))
        kept = {
            (fold, trial): read_finished(self._state.trial_file(trial.id, fold))
            for fold in folds
            for trial in whole
        }
        left = [self._task(trial, fold, True) for (fold, trial), done in kept.items() if not done]
        asked_for = left if self._request.nested else []
        for outcome in self._run(asked_for, "trials inside the folds"):
            if outcome.fault is not None:
                raise ToktError(f"--nested, {outcome.task.trial.name}: {outcome.fault}")
            fold = outcome.task.outer_fold
            if outcome.finished is not None and fold is not None:
                kept[fold, outcome.task.trial] = outcome.finished
        done = {place: finished.tally for place, finished in kept.items() if finished is not None}
        if len(done) < len(kept):
            return None
        inside = [{trial: done[fold, trial] for trial in whole} for fold in folds]
        return honest_score(whole, inside)

    def _model(self, trial: Trial, selection: str) -> tuple[RegisteredVersion, dict[str, Any]]:
        """The winner's version and figures: what an earlier run registered, or a new one."""
        request = self._request
        wanted = {"search": self._state.id, "extractor": trial.name}
        for version in self._registry.versions(request.name):
            if wanted.items() <= version.tags.items():
                metrics = self._registry.recipe(version)["metrics"]
                if selection in metrics["split"]:
                    return version, metrics
        wished = TrainRequest(
            *(request.dataset, request.name, build_extractor(trial.spec), trial.name),
            *(request.space.settings, request.split),
            search=self._state.id,
            selection=selection,
        )
        cache = request.workspace / "cache"
        trained = fit_and_measure(wished, cache, self._progress, request.jobs, request.dask)
        return log_and_register(trained, self._registry), trained.metrics

    def _result(
        self, ranks: tuple[Rank, ...], best: Rank, honest: dict[str, Any] | None, selection: str
    ) -> dict[str, Any]:
        request = self._request
        return {
            "search": self._state.id,
            "folder": str(self._state.folder),
            "rule": RULE,
            "dataset": request.dataset.label,
            "dataset_hash": request.dataset.hash,
            "split": request.split.parameters(),
            "parent_run_id": self._runs.parent_id,
            "tried": len(ranks),
            "trials": len(request.space.trials),
            "faults": self._faults,
            "ranks": [_rank_json(rank) for rank in ranks],
            "winner": {**_rank_json(best), "spec": best.trial.spec},
            "winner_file": str(self._state.folder / "winner.json"),
            "nested": honest,
            "selection": selection,
        }


def _rank_json(rank: Rank) -> dict[str, Any]:
    return {
        "extractor": rank.trial.name,
        "features": rank.trial.features,
        "pictures": rank.trial.pictures,
        "score": rank.score,
        "standard_error": rank.standard_error,
        "shortfall": rank.shortfall,
        "shortfall_error": rank.shortfall_error,
        "within_reach": rank.within,
    }
