"""The model registry (MLflow) and the way from a registered version to a bundle.

What a registered version consists of: ``model.tokt``, the bundle, in MLflow's model, which is a
pyfunc (`tokt.mlflow`); and, logged by its run as artifacts below ``tokt/``, ``recipe.json``
(extractor spec, grid, classes, thresholds, operating point, provenance, metrics) and
``held_out.parquet``. A version is registered after everything else is there, with the files' hashes
(`tokt.models.registry.registration`).

Recipes before version 4 have no bundle beside them. It is made of ``golden.npz``, ``lineage.npz``,
``distribution.npz`` (where the recipe's ``distribution`` is not null) and ``weights.npz`` below
``tokt/``. Version 0.1.0 wrote no hashes and no ``weights.npz``: of its scikit-learn pipeline tokt
reads the arrays, and opens nothing else.

The workspace's own registry keeps its artifacts in ``mlartifacts/`` beside it. MLflow writes their
absolute places into its database and has no way to relative ones (its issue 3144): they are not
read, so that a workspace that was moved or copied reads its own files.
"""

from __future__ import annotations

import io
import logging
import os
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from tokt.features.common import atomic
from tokt.features.common.address import without_credentials
from tokt.features.common.canonical import printable_json
from tokt.features.common.errors import ToktError
from tokt.features.common.terminal import say
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import (
    MAX_FILE_BYTES,
    MAX_MEMBER_BYTES,
    MAX_NAME,
    Bundle,
    BundleContent,
    bundle_bytes,
    bundle_from_bytes,
    distribution_from_bytes,
    golden_from_bytes,
    lineage_from_bytes,
    weights_from_bytes,
)
from tokt.models.bundle.card import model_card
from tokt.models.linear import LinearModel
from tokt.models.operating_point import OperatingPoint
from tokt.models.pretrained.packaged import VERSIONS as PACKAGED
from tokt.models.sight import sight_from_json, sight_to_json
from tokt.models.signing.keys import PublicKey, SigningKey
from tokt.models.store.history import one_line

from .registration import (
    DEPLOYMENT_TAG,
    PROMOTION_TAG,
    SIGNATURE_TAG,
    RegisteredVersion,
    record_tag,
)
from .skops_arrays import pipeline_arrays

# Before the first import of mlflow: a ship's PC has no network for usage statistics to wait on.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
# Standard output is for results, and a server that is down is said so in seconds.
os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")

import mlflow
import sqlalchemy
from mlflow.entities.model_registry import ModelVersion
from mlflow.exceptions import MlflowException
from mlflow.store.db.db_types import DATABASE_ENGINES
from mlflow.utils.file_utils import local_file_uri_to_path
from sqlalchemy.exc import SQLAlchemyError

if TYPE_CHECKING:
    import pandas

EXPERIMENT = "tokt"
RECIPE_VERSION = 5
"""Version 1 has no operating point, and no decision values in ``held_out.parquet``; 1 and 2 have no
distribution of features, 1 to 3 no bundle, 1 to 4 no numbers of sight."""
BUNDLE_FILE = "model.tokt"
"""The bundle's name in MLflow's model."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_Result = TypeVar("_Result")
_ARTIFACTS = "mlartifacts"
_PLACES = (
    *(("experiments", "artifact_location"), ("runs", "artifact_uri")),
    *(("logged_models", "artifact_location"), ("model_versions", "storage_location")),
)
"""Where MLflow's database names artifacts: tables and columns."""
_TEMPORARY = re.compile(r"file://.*/tmp\w{8}/0")
"""A place of MLflow's own experiment that an earlier tokt left in a folder of `tempfile`."""
_NO_VALUE = (TypeError, ValueError, SyntaxError, MemoryError, RecursionError)
"""What Python raises for a text that is no value; the last two where it is nested too deeply."""
_MAX_TABLE_BYTES = 1 << 32
_TEXTS, _NUMBERS = {"mission", "camera", "label", "group"}, ("frame", "row", "col", "fold")
_MAX_TABLE_VALUES = 500_000_000
"""Of ``held_out.parquet``: days of labelled frames; a small file can say it is far larger."""


def check_model_name(name: str) -> None:
    """Raise ToktError unless `name` can be a model's name, also in a file name."""
    if not _NAME.fullmatch(name) or len(name) > MAX_NAME:
        raise ToktError(
            f"model name {name!r}: use letters, digits, '-', '_' and '.', {MAX_NAME} at most"
        )
    if name in PACKAGED:
        raise ToktError(f"model name {name!r} is that of a model that comes with tokt")


def check_alias(alias: str) -> None:
    """Raise ToktError unless `alias` can be one."""
    if not _NAME.fullmatch(alias) or alias == "latest" or re.fullmatch(r"v\d+", alias):
        raise ToktError(
            f"{alias!r} cannot be an alias: give a word such as champion, unlike v2 or latest"
        )


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
    given = {name: os.environ.get(name) for name in ("MLFLOW_TRACKING_URI", "MLFLOW_REGISTRY_URI")}
    mlflow.set_tracking_uri(uri)
    mlflow.set_registry_uri(uri)
    # MLflow says it in the environment too, where another workspace's registry in this process
    # would take it for what the user asked for; so would a process that is started.
    for name, value in given.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


def _dialect(uri: str) -> str:
    return uri.partition(":")[0].partition("+")[0]


def _reach(uri: str) -> None:
    """Let a database that does not answer say so at once: MLflow would try for minutes."""
    engine = sqlalchemy.create_engine(uri)
    try:
        sqlalchemy.inspect(engine)
    finally:
        engine.dispose()


def _create_database(path: Path) -> None:
    """Make MLflow's tables under a temporary name, so that a kill leaves no half-made file."""
    atomic.remove_partials(path.parent, atomic.ABANDONED_S)
    with atomic.scratch_folder(path) as folder:
        fresh = folder / path.name
        atomic.write_bytes(fresh, _empty_database())
        # Of MLflow's own experiment, in which a user's runs without a name are.
        artifacts = (path.parent / _ARTIFACTS / "0").as_uri()
        with closing(sqlite3.connect(fresh)) as database, database:
            database.execute("UPDATE experiments SET artifact_location = ?", [artifacts])
        if not path.exists():
            atomic.rename(fresh, path)


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


def _move_places(database: Path, before: str, now: str) -> None:
    """Let MLflow read and write below `now` what it had below `before`."""
    with closing(sqlite3.connect(database, timeout=60)) as opened, opened:
        for table, column in _PLACES:
            opened.execute(
                f"UPDATE {table} SET {column} = ? || substr({column}, ?) "
                f"WHERE substr({column} || '/', 1, ?) = ?",
                (now, len(before) + 1, len(before) + 1, f"{before}/"),
            )


@contextmanager
def fitting(version: RegisteredVersion, what: str = "recipe.json") -> Iterator[None]:
    """Around what takes a recipe for what training writes: say that it is not."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, *_NO_VALUE) as error:
        fault = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ToktError(f"model {version.label}: its {what} does not fit ({fault})") from None


def retry_once(write: Callable[[], _Result]) -> _Result:
    """Call `write` again if it fails, because another process may just have written the same row.

    MLflow looks whether a row exists and then inserts it, in one transaction: of two processes that
    do so at the same time, one fails, and finds the row of the other when it tries again.
    """
    try:
        return write()
    except MlflowException:
        return write()


class Registry:
    """Runs and registered models of one workspace.

    The workspace holds ``mlflow.db`` and ``mlartifacts/`` unless ``MLFLOW_TRACKING_URI`` names a
    server; with `own` whatever the environment says. With `create` a missing ``mlflow.db`` is made;
    reading never does. Where `workspace` holds a copy of a database, `files_of` is the one whose
    artifacts are meant.

    Raises ToktError if there is no registry and none is to be made; so does each method if the
    registry cannot be reached, read or written.
    """

    def __init__(
        self,
        workspace: Path,
        *,
        create: bool = False,
        own: bool = False,
        files_of: Path | None = None,
    ) -> None:
        logging.getLogger("mlflow").setLevel(logging.WARNING)
        logging.getLogger("alembic").setLevel(logging.WARNING)
        self.workspace = workspace
        local = (workspace / "mlflow.db").resolve()
        self.uri = local_uri(workspace) if own else tracking_uri(workspace)
        self._database = local if self.uri == f"sqlite:///{local}" else None
        beside = workspace if self._database is None else local.parent
        self._artifacts = ((files_of or beside) / _ARTIFACTS).resolve()
        if self._database is not None and not local.exists():
            if not create:
                raise ToktError(
                    f"no model has been trained in workspace {workspace} yet (tokt train); the "
                    "model waters comes with tokt"
                )
            _create_database(local)
        if mlflow.active_run() is not None and mlflow.get_tracking_uri() != self.uri:
            # It could not be ended any more.
            raise ToktError("a run of another MLflow registry is active here: end it first")
        _use(self.uri)
        with self.reported():
            if _dialect(self.uri) in DATABASE_ENGINES and self._database is None:
                _reach(self.uri)
            self.client = mlflow.MlflowClient(self.uri, self.uri)
            if self._database is not None and files_of is None:
                self._keep_own_runs(self._database)

    @contextmanager
    def reported(self) -> Iterator[None]:
        """Turn what MLflow cannot do (server down, database damaged, no driver) into ToktError."""
        try:
            yield
        except (MlflowException, SQLAlchemyError, sqlite3.Error, ModuleNotFoundError) as error:
            reason = str(error).strip().partition("\n")[0]
            line = f"the model registry at {self.uri}: {reason}"
            raise ToktError(without_credentials(line)) from error

    def experiment_id(self) -> str:
        """The id of the experiment that tokt's runs go to; created when missing."""
        # A server has a place for artifacts; a database alone has none.
        location = self._artifacts.as_uri() if _dialect(self.uri) in DATABASE_ENGINES else None
        with self.reported():
            return retry_once(lambda: self._experiment_id(location))

    def _experiment_id(self, location: str | None) -> str:
        found = self.client.get_experiment_by_name(EXPERIMENT)
        if found is None:
            return str(self.client.create_experiment(EXPERIMENT, artifact_location=location))
        if found.artifact_location is None:
            where = without_credentials(self.uri)
            raise ToktError(f"the model registry at {where}: it has no artifact folder")
        if self._database is not None and found.artifact_location != location:
            # After the workspace was moved or copied: what is logged from now on goes to its own.
            _move_places(self._database, found.artifact_location, self._artifacts.as_uri())
        return str(found.experiment_id)

    def _keep_own_runs(self, database: Path) -> None:
        """Give MLflow's own experiment, where its place is temporary, one here with its files."""
        default = self.client.get_experiment_by_name("Default")
        if default is None or not _TEMPORARY.fullmatch(default.artifact_location):
            return
        place = Path(local_file_uri_to_path(default.artifact_location))
        own, runs = self._artifacts / "0", self.client.search_runs([default.experiment_id])
        try:
            if place.is_dir() and not own.exists():
                with atomic.new_folder(own) as folder:
                    shutil.copytree(place, folder, symlinks=True, dirs_exist_ok=True)
            _move_places(database, default.artifact_location, own.as_uri())
            lost = [run.info.run_name for run in runs if not (own / run.info.run_id).exists()]
            state = f"they go to {own} now; lost: {', '.join(lost) or 'none'}"
        except (OSError, sqlite3.Error) as error:
            state = f"they cannot be moved to {own}: {error}"
        if runs:
            say(f"WARNING: your own MLflow runs had their files in {place} (temporary); {state}")

    def register(
        self, name: str, model_uri: str, run_id: str, model_id: str, tags: dict[str, str]
    ) -> RegisteredVersion:
        """Register what a run logged as a new version of `name`."""
        with self.reported():
            try:
                self.client.get_registered_model(name)
            except MlflowException:
                with suppress(MlflowException):  # another process may have made it meanwhile
                    self.client.create_registered_model(name)
            version = self.client.create_model_version(
                name, source=model_uri, run_id=run_id, model_id=model_id, tags=tags
            )
        return self._listed(version)

    def next_number(self, name: str, least: int = 1) -> int:
        """The number that MLflow gives next, unless the newest was deleted or others register."""
        with self.reported():
            newest = self.client.search_model_versions(
                f"name = '{name}'", max_results=1, order_by=["version_number DESC"]
            )
        return max(int(newest[0].version) + 1 if newest else 1, least)

    def withdraw(self, version: RegisteredVersion) -> None:
        """Delete a version that was registered a moment ago."""
        with self.reported():
            self.client.delete_model_version(version.name, version.version)

    def sign(self, version: RegisteredVersion, key: SigningKey) -> None:
        """Let `key` vouch for a version as it was registered."""
        self._tag(version, SIGNATURE_TAG, version.signature(key))

    def record_promotion(self, version: RegisteredVersion, record: dict[str, str]) -> None:
        """Keep how a promotion of a version ended, beside what was kept before."""
        self._tag(version, *record_tag(PROMOTION_TAG, record))

    def record_deployment(self, label: str, store: Path, sha256: str, why: str) -> None:
        """Keep that a version's bundle, which has this SHA-256, was deployed to a store."""
        record = {"store": one_line(str(store.resolve())), "sha256": sha256, "why": why}
        self._tag(self.find(label), *record_tag(DEPLOYMENT_TAG, record))

    def _tag(self, version: RegisteredVersion, key: str, value: str) -> None:
        with self.reported():
            self.client.set_model_version_tag(version.name, version.version, key, value)

    def versions(self, name: str | None = None) -> list[RegisteredVersion]:
        """Every version that is its `own`, or those of one model, by name, newest first."""
        wanted = None if name is None else f"name = '{name}'"
        found: list[RegisteredVersion] = []
        token: str | None = None
        with self.reported():
            while token != "":
                page = self.client.search_model_versions(wanted, page_token=token)
                own = (each for each in page if self._listed(each).own)  # others may just be gone
                # The search leaves the aliases out.
                whole = (self.client.get_model_version(each.name, each.version) for each in own)
                found += map(self._listed, whole)
                token = page.token or ""
        return sorted(found, key=lambda item: (item.name, -int(item.version)))

    def find(self, reference: str) -> RegisteredVersion:
        """The version of ``name`` (newest), ``name@alias`` or ``name/version``, or ToktError."""
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
        """Point `alias` at a version, away from any other; an error names where it points then."""
        version = self.find(reference)
        check_alias(alias)
        point = self.client.set_registered_model_alias
        try:
            with self.reported():
                retry_once(lambda: point(version.name, alias, version.version))
        except ToktError as error:
            known = self.versions(version.name)
            at = next((one.label for one in known if alias in one.aliases), "no version")
            if at != version.label:
                raise ToktError(f"{error}; {version.name}@{alias} is {at}") from error
        return self.find(version.label)

    def check(self, version: RegisteredVersion) -> None:
        """Raise ToktError unless all files of a version are what it was registered with."""
        with fitting(version):
            for name in version.files:
                self._artifact(version, name, _MAX_TABLE_BYTES)

    def recipe(self, version: RegisteredVersion) -> dict[str, Any]:
        """The run's ``recipe.json``, all but weights; ToktError if missing, or a newer tokt's."""
        try:
            recipe = printable_json(self._artifact(version, "recipe.json"))
            written = recipe.get("recipe_version")
        except (ValueError, AttributeError, RecursionError):
            raise ToktError(f"model {version.label}: its recipe.json is damaged") from None
        if type(written) is not int or not 1 <= written <= RECIPE_VERSION:
            raise ToktError(f"model {version.label} was trained by another generation of tokt")
        if recipe.get("hashed") and not version.hashed:
            raise ToktError(f"model {version.label}: the hashes of its files are gone")
        none = {"operating_point": OperatingPoint().to_json(), "distribution": None}
        return {**none, "sight": sight_to_json(()), **recipe}

    def parameters(self, version: RegisteredVersion) -> dict[str, str]:
        """What the version's run logged of how it was trained, as text."""
        with self.reported():
            return dict(self.client.get_run(version.run_id).data.params)

    def held_out(self, reference: str | RegisteredVersion) -> pandas.DataFrame:
        """What cross-validation said of each patch, by a model that did not learn from it.

        The dataset's patches with fold (-1: never tested), obstacle_score and, since recipe version
        2, target (index of the class) and value_0 .. value_{k-1}.

        Raises ToktError if there is no such version, or its run holds no such table.
        """
        from pyarrow import ArrowException, parquet

        version = self.find(reference) if isinstance(reference, str) else reference
        data = self._artifact(version, "held_out.parquet", _MAX_TABLE_BYTES)
        try:
            file = parquet.ParquetFile(io.BytesIO(data))
            if file.metadata.num_rows * file.metadata.num_columns > _MAX_TABLE_VALUES:
                raise ToktError(f"model {version.label}: its held_out.parquet is far too large")
            # pandas' own notes in the file say nothing that its columns do not.
            table = file.read().to_pandas(ignore_metadata=True)
        except (ArrowException, OSError, ValueError) as error:
            fault = str(error).strip().partition("\n")[0]
            raise ToktError(f"model {version.label}: held_out.parquet: {fault}") from None
        kinds = {name: table[name].dtype.kind for name in table} if table.columns.is_unique else {}
        numbers = [*_NUMBERS, *(name for name in kinds if name.startswith("value_"))]
        if not set(kinds) >= _TEXTS or any(kinds.get(name) not in ("i", "f") for name in numbers):
            raise ToktError(f"model {version.label}: held_out.parquet is not what training writes")
        return table

    def bundle(
        self,
        reference: str,
        signer: PublicKey | None = None,
        *,
        signed: bool = False,
        notice: Callable[[str], None] = lambda text: None,
    ) -> Bundle:
        """A registered version as a checked bundle; the same version gives the same bytes.

        The registration's signature is checked against `signer`; with `signed` it must be there.
        `notice` is told what could not be checked.

        Raises ToktError if it is not there, was not trained by tokt, is not what was registered, or
        fails its own golden check.
        """
        version = self.find(reference)
        if signer is not None and not version.check_signature(signer):
            unsigned = f"the registration of model {version.label} is not signed"
            if signed:
                raise ToktError(f"{unsigned}, by key {signer.id} or any other")
            notice(f"WARNING: {unsigned} (tokt train --sign): it is taken as the workspace has it")
        if not version.hashed:
            notice(
                f"note: {version.label} was registered by tokt 0.1.0, without hashes of its files"
            )
        recipe = self.recipe(version)
        with fitting(version):
            if BUNDLE_FILE in version.files:
                data = self._artifact(version, BUNDLE_FILE, MAX_FILE_BYTES)
            else:
                data = bundle_bytes(self._content(version, recipe))
        bundle = bundle_from_bytes(data, f"model {version.label}")
        if bundle.label != version.label:
            raise ToktError(f"model {version.label}: its bundle is of {bundle.label}")
        return bundle

    def _content(self, version: RegisteredVersion, recipe: dict[str, Any]) -> BundleContent:
        where = f"model {version.label}"
        distribution = None
        if recipe["distribution"] is not None:
            data = self._artifact(version, "distribution.npz")
            distribution = distribution_from_bytes(data, where)
        provenance = {**recipe["provenance"], "mlflow_run_id": version.run_id}
        return BundleContent(
            name=version.name,
            version=version.version,
            extractor_spec=recipe["extractor"],
            grid=Grid.from_json(recipe["grid"]),
            model=self._model(version, recipe),
            provenance=provenance,
            metrics=recipe["metrics"],
            golden=golden_from_bytes(self._artifact(version, "golden.npz"), where),
            trained_on=lineage_from_bytes(self._artifact(version, "lineage.npz"), where),
            card=model_card(version.label, recipe, provenance),
            operating_point=OperatingPoint.from_json(recipe["operating_point"]),
            distribution=distribution,
            sight=sight_from_json(recipe["sight"]),
        )

    def _model(self, version: RegisteredVersion, recipe: dict[str, Any]) -> LinearModel:
        where = f"model {version.label}"
        classes = tuple(item["name"] for item in recipe["classes"])
        obstacle = tuple(item["obstacle"] for item in recipe["classes"])
        if version.hashed:
            arrays = weights_from_bytes(self._artifact(version, "weights.npz"), where)
            return LinearModel(**arrays, classes=classes, obstacle=obstacle)
        data = self._model_file(version, recipe, "model.skops", MAX_MEMBER_BYTES)
        arrays = pipeline_arrays(data, f"{where}: model.skops")
        coef, intercept = arrays["coef_"], arrays["intercept_"]
        mean = arrays.get("mean_", np.zeros(coef.shape[-1]))
        scale = arrays.get("scale_", np.ones(coef.shape[-1]))
        thresholds = np.array(recipe["thresholds"], np.float64)
        with np.errstate(all="ignore"):  # what is not finite is refused there
            return LinearModel.fold(coef, intercept, mean, scale, thresholds, classes, obstacle)

    def _artifact(
        self, version: RegisteredVersion, name: str, most: int = MAX_MEMBER_BYTES
    ) -> bytes:
        """A file of the version's run, or its bundle, as it was registered."""
        run = version.run_id
        if name == BUNDLE_FILE:
            data = self._model_file(version, self.recipe(version), f"data/{name}", most)
        else:
            place, uri = f"{run}/artifacts/tokt/{name}", f"runs:/{run}/tokt/{name}"
            data = self._read(version, place, uri, most)
        if version.hashed:
            version.check(name, data)
        return data

    def _model_file(
        self, version: RegisteredVersion, recipe: dict[str, Any], file: str, most: int
    ) -> bytes:
        """A file of MLflow's model."""
        place = f"models/{recipe['provenance']['mlflow_model_id']}/artifacts/{file}"
        return self._read(version, place, f"models:/{version.label}/{file}", most)

    def _read(self, version: RegisteredVersion, place: str, uri: str, most: int) -> bytes:
        """A file at its place in the workspace's own registry, or at its URI in another one."""
        if self._database is not None:
            return self._read_own(version, self._artifacts / place, most)
        name = uri.rpartition("/")[2]
        try:
            with tempfile.TemporaryDirectory() as folder:
                return Path(mlflow.artifacts.download_artifacts(uri, dst_path=folder)).read_bytes()
        except (MlflowException, OSError):
            missing = f"{name} is missing from its run; was it trained by tokt?"
            raise ToktError(f"model {version.label}: {missing}") from None

    def _read_own(self, version: RegisteredVersion, file: Path, most: int) -> bytes:
        where = f"model {version.label}: {file.name}"
        try:
            # The ids in a place come from files that others may have written.
            whole = file.resolve() == file and file.is_relative_to(self._artifacts)
            if not whole:
                raise ToktError(f"{where} is not in the workspace itself, but behind a link")
            if not file.is_file():
                missing = f"is missing from its run ({file}); was it trained by tokt?"
                raise ToktError(f"{where} {missing}")
            if file.stat().st_size > most:
                raise ToktError(f"{where} is far too large")
            return file.read_bytes()
        except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a circle
            raise ToktError(f"{where} cannot be read ({error})") from None

    @staticmethod
    def _listed(version: ModelVersion) -> RegisteredVersion:
        return RegisteredVersion(
            name=version.name,
            version=str(version.version),
            aliases=tuple(sorted(map(str, version.aliases or ()))),
            run_id=version.run_id or "",
            tags={str(key): str(value) for key, value in (version.tags or {}).items()},
        )
