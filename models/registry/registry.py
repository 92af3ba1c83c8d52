"""The model registry (MLflow) and the way from a registered version to a bundle.

What a registered version consists of, all logged by its run: the scikit-learn pipeline (the truth
about the weights, stored by skops, no pickle), and the run artifacts below ``tokt/``:
``recipe.json`` (extractor spec, grid, classes, thresholds, operating point, provenance, metrics),
``golden.npz``, ``lineage.npz``, ``distribution.npz`` (where the recipe's ``distribution`` is not
null) and ``held_out.parquet``. A version is registered after everything
else is there.
"""

from __future__ import annotations

import io
import json
import logging
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import (
    Bundle,
    BundleContent,
    bundle_bytes,
    bundle_from_bytes,
    distribution_from_bytes,
    golden_from_bytes,
    lineage_from_bytes,
)
from tokt.models.bundle.card import model_card
from tokt.models.linear import LinearModel
from tokt.models.operating_point import OperatingPoint

# Before the first import of mlflow: a ship's PC has no network for usage statistics to wait on.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
# Standard output is for results, and a server that is down is said so in seconds.
os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")

import mlflow
from mlflow.entities.model_registry import ModelVersion
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

if TYPE_CHECKING:
    import pandas

EXPERIMENT = "tokt"
RECIPE_VERSION = 3
"""Version 1 has no operating point, and no decision values in ``held_out.parquet``; 1 and 2 have no
distribution of features."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def check_model_name(name: str) -> None:
    """Raise ToktError unless `name` can be a model's name, also in a file name."""
    if not _NAME.fullmatch(name):
        raise ToktError(f"model name {name!r}: use letters, digits, '-', '_' and '.'")


def local_uri(workspace: Path) -> str:
    """The workspace's own file as a tracking URI."""
    file = (workspace / "mlflow.db").resolve()
    if "?" in str(file):
        raise ToktError(f"workspace {workspace}: MLflow cannot keep its file in a path with '?'")
    return f"sqlite:///{file}"


def tracking_uri(workspace: Path) -> str:
    """Where runs and models are kept: ``MLFLOW_TRACKING_URI``, or the workspace's own file."""
    return os.environ.get("MLFLOW_TRACKING_URI") or local_uri(workspace)


def _use(uri: str) -> None:
    """Make `uri` MLflow's own, for its functions that have no client to be called on."""
    given = os.environ.get("MLFLOW_TRACKING_URI")
    mlflow.set_tracking_uri(uri)
    mlflow.set_registry_uri(uri)
    # MLflow says it in the environment too, where another workspace's registry in this process
    # would take it for what the user asked for.
    if given is None:
        os.environ.pop("MLFLOW_TRACKING_URI", None)
    else:
        os.environ["MLFLOW_TRACKING_URI"] = given


def _create_database(path: Path) -> None:
    """Make MLflow's tables under a temporary name, so that a kill leaves no half-made file."""
    atomic.remove_partials(path.parent, atomic.ABANDONED_S)
    with atomic.scratch_folder(path) as folder:
        fresh = folder / path.name
        atomic.write_bytes(fresh, _empty_database())
        if not path.exists():
            fresh.replace(path)


@cache
def _empty_database() -> bytes:
    """MLflow's tables as a file's content.

    MLflow migrates a new database through all its past: that takes a second, in memory, where it
    waits for no disk.
    """
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

    with tempfile.TemporaryDirectory() as unused:
        store = SqlAlchemyStore("sqlite:///:memory:", Path(unused).as_uri())
        with closing(store.engine.raw_connection()) as made:
            content: bytes = made.driver_connection.serialize()
        store.engine.dispose()
    return content


@dataclass(frozen=True)
class RegisteredVersion:
    """One line of ``tokt models list``."""

    name: str
    version: str
    aliases: tuple[str, ...]
    run_id: str
    tags: dict[str, str]

    @property
    def label(self) -> str:
        """``name/version``."""
        return f"{self.name}/{self.version}"


def _provenance(version: RegisteredVersion, recipe: dict[str, Any]) -> dict[str, Any]:
    return {**recipe["provenance"], "mlflow_run_id": version.run_id}


class Registry:
    """Runs and registered models of one workspace.

    Parameters
    ----------
    workspace : Path
        Holds ``mlflow.db`` and ``mlartifacts/`` unless ``MLFLOW_TRACKING_URI`` names a server.
    create : bool
        Whether to make ``mlflow.db`` where there is none; reading never does.
    own : bool
        Use the workspace's own file whatever the environment says.

    Raises
    ------
    ToktError
        If there is no registry and none is to be made, or it cannot be reached.
    """

    def __init__(self, workspace: Path, *, create: bool = False, own: bool = False) -> None:
        logging.getLogger("mlflow").setLevel(logging.WARNING)
        logging.getLogger("alembic").setLevel(logging.WARNING)
        self.workspace = workspace
        local = (workspace / "mlflow.db").resolve()
        self.uri = local_uri(workspace) if own else tracking_uri(workspace)
        if self.uri == f"sqlite:///{local}" and not local.exists():
            if not create:
                raise ToktError(f"no model has been trained in workspace {workspace} yet")
            _create_database(local)
        _use(self.uri)
        with self.reported():
            self.client = mlflow.MlflowClient(self.uri, self.uri)

    @contextmanager
    def reported(self) -> Iterator[None]:
        """Turn what MLflow cannot do (server down, database damaged) into a ToktError."""
        try:
            yield
        except (MlflowException, SQLAlchemyError) as error:
            reason = str(error).strip().splitlines()[0]
            raise ToktError(f"the model registry at {self.uri}: {reason}") from error

    def experiment_id(self) -> str:
        """The id of the experiment that tokt's runs go to; created when missing.

        Raises
        ------
        ToktError
            If the registry cannot be reached or written.
        """
        local = self.uri.startswith("sqlite:")
        location = (self.workspace / "mlartifacts").resolve().as_uri() if local else None
        with self.reported():
            found = self.client.get_experiment_by_name(EXPERIMENT)
            if found is not None:
                return str(found.experiment_id)
            try:
                return str(self.client.create_experiment(EXPERIMENT, artifact_location=location))
            except MlflowException:
                # Another process may have made it meanwhile.
                again = self.client.get_experiment_by_name(EXPERIMENT)
                if again is None:
                    raise
                return str(again.experiment_id)

    def register(
        self, name: str, model_uri: str, run_id: str, model_id: str, tags: dict[str, str]
    ) -> RegisteredVersion:
        """Register what a run logged as a new version of `name`."""
        with self.reported():
            try:
                self.client.get_registered_model(name)
            except MlflowException:
                self.client.create_registered_model(name)
            version = self.client.create_model_version(
                name, source=model_uri, run_id=run_id, model_id=model_id, tags=tags
            )
        return self._listed(version)

    def versions(self, name: str | None = None) -> list[RegisteredVersion]:
        """Every registered version, or those of one model, by name, newest first.

        Raises
        ------
        ToktError
            If the registry cannot be read.
        """
        wanted = None if name is None else f"name = '{name}'"
        found: list[RegisteredVersion] = []
        token: str | None = None
        with self.reported():
            while token != "":
                page = self.client.search_model_versions(wanted, page_token=token)
                # The search leaves the aliases out.
                whole = (self.client.get_model_version(each.name, each.version) for each in page)
                found += map(self._listed, whole)
                token = page.token or ""
        return sorted(found, key=lambda item: (item.name, -int(item.version)))

    def find(self, reference: str) -> RegisteredVersion:
        """The version behind ``name`` (its newest), ``name@alias`` or ``name/version``.

        Raises
        ------
        ToktError
            If there is no such model, alias or version.
        """
        match = re.fullmatch(r"([^@/]+)(?:@([^@/]+)|/(\d+))?", reference)
        if match is None:
            raise ToktError(f"not a model: {reference!r} (write NAME, NAME@ALIAS or NAME/VERSION)")
        name, alias, number = match[1], match[2], match[3]
        known = self.versions(name) if _NAME.fullmatch(name) else []
        if not known:
            names = ", ".join(sorted({item.name for item in self.versions()})) or "none yet"
            raise ToktError(f"no model {name!r} in the registry (there are: {names})")
        for item in known:
            if alias in item.aliases or item.version == number or (not alias and not number):
                return item
        wanted = f"alias {alias!r}" if alias else f"version {number}"
        raise ToktError(f"model {name!r} has no {wanted}")

    def set_alias(self, reference: str, alias: str) -> RegisteredVersion:
        """Point `alias` at a version, away from any other."""
        version = self.find(reference)
        if not _NAME.fullmatch(alias) or alias == "latest" or re.fullmatch(r"v\d+", alias):
            raise ToktError(f"{alias!r} cannot be an alias")
        with self.reported():
            self.client.set_registered_model_alias(version.name, alias, version.version)
        return self.find(version.label)

    def recipe(self, version: RegisteredVersion) -> dict[str, Any]:
        """The run's ``recipe.json``: all of a model but its weights.

        Raises
        ------
        ToktError
            If it is missing, or a newer tokt wrote it.
        """
        text = self._artifact(version, "recipe.json").decode("utf-8")
        recipe: dict[str, Any] = json.loads(text)
        written = recipe.get("recipe_version")
        if type(written) is not int or not 1 <= written <= RECIPE_VERSION:
            raise ToktError(f"model {version.label} was trained by another generation of tokt")
        return {"operating_point": OperatingPoint().to_json(), "distribution": None, **recipe}

    def held_out(self, reference: str) -> pandas.DataFrame:
        """What cross-validation said of every patch, by a model that did not learn from it.

        Returns
        -------
        pandas.DataFrame
            The dataset's patches with fold (-1: never tested), obstacle_score and, since recipe
            version 2, target (index of the class) and value_0 .. value_{k-1}.

        Raises
        ------
        ToktError
            If there is no such version, or its run holds no such table.
        """
        import pandas as pd

        data = self._artifact(self.find(reference), "held_out.parquet")
        return pd.read_parquet(io.BytesIO(data))

    def card(self, reference: str) -> str:
        """The model card of a registered version, as its bundle has it.

        Raises
        ------
        ToktError
            If there is no such version, or it was not trained by tokt.
        """
        version = self.find(reference)
        recipe = self.recipe(version)
        return model_card(version.label, recipe, _provenance(version, recipe))

    def bundle(self, reference: str) -> Bundle:
        """A registered version as a checked bundle; the same version gives the same bytes.

        Raises
        ------
        ToktError
            If it is not there, was not trained by tokt, or fails its own golden check.
        """
        version = self.find(reference)
        content = self._content(version, self.recipe(version))
        return bundle_from_bytes(bundle_bytes(content), f"model {version.label}")

    def _content(self, version: RegisteredVersion, recipe: dict[str, Any]) -> BundleContent:
        where = f"model {version.label}"
        with self.reported(), tempfile.TemporaryDirectory() as folder:
            pipeline = mlflow.sklearn.load_model(f"models:/{version.label}", dst_path=folder)
        distribution = None
        if recipe["distribution"] is not None:
            data = self._artifact(version, "distribution.npz")
            distribution = distribution_from_bytes(data, where)
        model = LinearModel.from_pipeline(
            pipeline,
            np.array(recipe["thresholds"], np.float64),
            tuple(item["name"] for item in recipe["classes"]),
            tuple(item["obstacle"] for item in recipe["classes"]),
        )
        provenance = _provenance(version, recipe)
        return BundleContent(
            name=version.name,
            version=version.version,
            extractor_spec=recipe["extractor"],
            grid=Grid.from_json(recipe["grid"]),
            model=model,
            provenance=provenance,
            metrics=recipe["metrics"],
            golden=golden_from_bytes(self._artifact(version, "golden.npz"), where),
            trained_on=lineage_from_bytes(self._artifact(version, "lineage.npz"), where),
            card=model_card(version.label, recipe, provenance),
            operating_point=OperatingPoint.from_json(recipe["operating_point"]),
            distribution=distribution,
        )

    def _artifact(self, version: RegisteredVersion, name: str) -> bytes:
        uri = f"runs:/{version.run_id}/tokt/{name}"
        try:
            with tempfile.TemporaryDirectory() as folder:
                return Path(mlflow.artifacts.download_artifacts(uri, dst_path=folder)).read_bytes()
        except (MlflowException, OSError):
            missing = f"{name} is missing from its run; was it trained by tokt?"
            raise ToktError(f"model {version.label}: {missing}") from None

    @staticmethod
    def _listed(version: ModelVersion) -> RegisteredVersion:
        return RegisteredVersion(
            name=version.name,
            version=str(version.version),
            aliases=tuple(sorted(version.aliases or ())),
            run_id=version.run_id or "",
            tags={str(key): str(value) for key, value in (version.tags or {}).items()},
        )
