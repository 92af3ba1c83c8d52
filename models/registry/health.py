"""Health of a workspace's model registry, for `tokt doctor`.

MLflow is imported only when there is a registry to look at, and opens a copy: it may write to a
database that it only reads.
"""

import os
import re
import tempfile
from pathlib import Path

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError
from tokt.features.common.sqlite_copy import copy_database, damage

NAME = "registry"
_VARIABLE = "MLFLOW_TRACKING_URI"
_SQLITE = "sqlite:///"
_FILE_NAME = "mlflow.db"
_REQUEST_TIMEOUT_S = "10"


def registry_finding(workspace: Path) -> Finding:
    """Examine the registry that tokt's commands would use, without writing to it.

    Raises ToktError or OSError if its file cannot be read.
    """
    uri = os.environ.get(_VARIABLE, "")
    if not uri:
        return _file_finding(workspace / _FILE_NAME, workspace)
    if uri.startswith(_SQLITE):
        return _file_finding(Path(uri.removeprefix(_SQLITE).partition("?")[0]))
    if uri.startswith(("http://", "https://")):
        os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", _REQUEST_TIMEOUT_S)
        try:
            return _counted(workspace, _shown(uri), own=False)
        except ToktError as error:
            return Finding(NAME, FAULT, _shown(str(error)))
    return Finding(NAME, NOTE, f"{_shown(uri)} ({_VARIABLE}): not examined, it might be changed")


def _shown(text: str) -> str:
    """Without a password, for what is printed may be sent to others."""
    return re.sub(r"//[^/@\s]*@", "//***@", text)


def _file_finding(file: Path, workspace: Path | None = None) -> Finding:
    if not file.exists():
        return Finding(NAME, NOTE, f"no registry yet ({file}); tokt train makes it")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name).resolve()
        copy = folder / _FILE_NAME
        copy_database(file, copy)
        broken = damage(copy)
        if broken:
            return Finding(NAME, FAULT, f"{file} is damaged: {broken}")
        try:
            return _counted(folder, str(file), own=True, files_of=workspace)
        except ToktError as error:
            return Finding(NAME, FAULT, str(error).replace(str(copy), str(file)))


def _counted(workspace: Path, where: str, own: bool, files_of: Path | None = None) -> Finding:
    try:
        from .registry import Registry
    except ModuleNotFoundError as error:
        text = f"{where}: not opened, {error.name} is not installed (extra 'train')"
        return Finding(NAME, NOTE, text)
    copied = workspace if own else None  # a copy is not mended
    registry = Registry(workspace, own=own, files_of=files_of or copied)
    versions = registry.versions()
    if files_of is not None:
        for version in versions:
            registry.check(version)
    models = len({version.name for version in versions})
    text = f"{where}: models: {models}, versions: {len(versions)}"
    return Finding(NAME, OK, text, {"models": models, "versions": len(versions)})
