"""MLflow runs of a search: a parent, and a child for each finished trial, exactly once.

What is logged already is asked of the registry itself, by tags, and not remembered elsewhere: so
a search that was killed between logging and remembering makes no run twice.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from mlflow.entities import Metric, Param, Run
from mlflow.utils.mlflow_tags import MLFLOW_PARENT_RUN_ID, MLFLOW_RUN_NAME

from tokt.models.registry.registry import Registry

from .space import Trial
from .state import Finished

SEARCH_TAG = "tokt.search"
TRIAL_TAG = "tokt.trial"
_FINISHED = "FINISHED"
_PARAM_CHARS = 6000  # MLflow's limit on a parameter


class SearchRuns:
    """The runs of one search; name and parameters are those of the parent run."""

    def __init__(
        self, registry: Registry, search_id: str, name: str, parameters: Mapping[str, Any]
    ) -> None:
        self._registry, self._client = registry, registry.client
        self._search_id = search_id
        self._experiment = registry.experiment_id()
        with registry.reported():
            self._known = {run.data.tags.get(TRIAL_TAG): run for run in self._earlier()}
            self.parent_id = self._begun(None, name, parameters)

    def _earlier(self) -> Iterator[Run]:
        wanted, token = f"tags.`{SEARCH_TAG}` = '{self._search_id}'", None
        while token != "":
            page = self._client.search_runs([self._experiment], wanted, page_token=token)
            yield from page
            token = page.token or ""

    def _begun(self, trial: str | None, name: str, parameters: Mapping[str, Any]) -> str:
        """The run of a trial, or the parent's, begun now or by an earlier process."""
        found = self._known.get(trial)
        if found is not None:
            run_id = str(found.info.run_id)
            self._client.update_run(run_id, status="RUNNING")
            return run_id
        tags = {SEARCH_TAG: self._search_id, MLFLOW_RUN_NAME: name}
        if trial is not None:
            tags |= {TRIAL_TAG: trial, MLFLOW_PARENT_RUN_ID: self.parent_id}
        run = self._client.create_run(self._experiment, tags=tags)
        self._known[trial] = run
        self._log(run, {}, parameters)
        return str(run.info.run_id)

    def _log(
        self, run: Run, metrics: Mapping[str, float], params: Mapping[str, Any], when: int = 0
    ) -> None:
        # The same time each time, unless told otherwise: a metric logged twice is then one.
        when = when or int(run.info.start_time)
        self._client.log_batch(
            run.info.run_id,
            metrics=[Metric(name, value, when, 0) for name, value in metrics.items()],
            params=[Param(name, str(value)[:_PARAM_CHARS]) for name, value in params.items()],
        )

    def log(self, trial: Trial, finished: Finished) -> None:
        """Log a finished trial as a child run, unless that was done."""
        known = self._known.get(trial.id)
        if known is not None and known.info.status == _FINISHED:
            return
        parameters = {
            "extractor": trial.name,
            "spec": trial.spec,
            "features": trial.features,
            "pictures": trial.pictures,
            "choices": [f"C {c.penalty:g}, {c.class_weight}" for c in finished.choices],
        }
        metrics = {
            "cv_score": finished.tally.score,
            "cv_score_standard_error": finished.tally.standard_error,
            "seconds": finished.seconds,
        }
        with self._registry.reported():
            run_id = self._begun(trial.id, trial.name, parameters)
            self._log(self._known[trial.id], metrics, parameters)
            self._client.set_terminated(run_id, _FINISHED)

    def adopt(self, run_id: str) -> None:
        """Hang the winner's own training run below the search."""
        with self._registry.reported():
            self._client.set_tag(run_id, MLFLOW_PARENT_RUN_ID, self.parent_id)

    def report(self, metrics: Mapping[str, float], tags: Mapping[str, str]) -> None:
        """Log what came out to the parent run."""
        with self._registry.reported():
            # Each time anew: of values of the same time MLflow shows the largest, not the last.
            self._log(self._known[None], metrics, {}, int(time.time() * 1000))
            for name, value in tags.items():
                self._client.set_tag(self.parent_id, name, value)

    @contextmanager
    def running(self) -> Iterator[None]:
        """End the parent run as the block ends: finished, or failed where it raises."""
        status = "FAILED"
        try:
            yield
            status = _FINISHED
        finally:
            with self._registry.reported():
                self._client.set_terminated(self.parent_id, status)
