"""Names of registered models and aliases, for a shell's completion too: without MLflow."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

CHAMPION = "champion"
"""The alias of the version that is in use."""
_SQLITE = "sqlite:///"
REFERENCES = """
    SELECT name FROM registered_models
    UNION ALL SELECT name || '@' || alias FROM registered_model_aliases
    UNION ALL SELECT name || '/' || version FROM model_versions
"""
ALIASES = "SELECT DISTINCT alias FROM registered_model_aliases"


def registered_names(workspace: Path, query: str) -> list[str]:
    """What a query (`REFERENCES`, `ALIASES`) finds in a file that can be read at once, sorted."""
    uri = os.environ.get("MLFLOW_TRACKING_URI") or f"{_SQLITE}{workspace / 'mlflow.db'}"
    if not uri.startswith(_SQLITE):
        return []
    file = Path(uri.removeprefix(_SQLITE).partition("?")[0]).resolve()
    try:
        with closing(sqlite3.connect(f"{file.as_uri()}?mode=ro", timeout=0, uri=True)) as database:
            return sorted(name for (name,) in database.execute(query))
    except sqlite3.Error:
        return []
