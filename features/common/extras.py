"""The extras of an install: which one brings a package, and the words where it is missing."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import ToktError

_BROUGHT = {
    "train": "mlflow sklearn scipy pandas pyarrow joblib threadpoolctl sqlalchemy matplotlib "
    "jinja2 skimage mahotas",
    "label": "fastapi starlette pydantic uvicorn yaml",
    "camera": "pymba",
    "vimbax": "vmbpy",
    "genicam": "harvesters genicam",
    "video": "av aiortsp",
    "mavlink": "pymavlink serial",
    "metrics": "prometheus_client",
    "sign": "cryptography",
    "colmap": "pycolmap",
    "cluster": "dask distributed",
}
EXTRAS = {package: extra for extra, brought in _BROUGHT.items() for package in brought.split()}
"""The extra that brings a package, by the name it is imported by."""


class MissingExtraError(ToktError, ImportError):
    """A package is missing that an extra of tokt brings."""


def missing_extra(
    error: ModuleNotFoundError, who: str, extra: str | None = None
) -> MissingExtraError | None:
    """What to install where `who` needs a package that is not there; None for any other package.

    `extra` is named where several bring the package.
    """
    package = (error.name or "").partition(".")[0]
    if package == "tokt_studies":
        return MissingExtraError(f"{who} needs {package}: install the distribution tokt-studies")
    if package not in EXTRAS:
        return None
    wanted = extra or EXTRAS[package]
    return MissingExtraError(f"{who} needs {package}: install the extra '{wanted}'")


@contextmanager
def needed_by(who: str, extra: str | None = None) -> Iterator[None]:
    """Around imports that an extra may have to bring."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_extra(error, who, extra)
        if missing is None:
            raise
        raise missing from None
