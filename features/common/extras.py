"""The extras of an install: which one brings a package, and the words where it is missing."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import ToktError

EXTRAS = {
    "scipy": "train",
    **dict.fromkeys(("mlflow", "sklearn", "skops", "pandas", "pyarrow", "joblib"), "train"),
    **dict.fromkeys(("matplotlib", "jinja2", "skimage", "mahotas"), "train"),
    **dict.fromkeys(("fastapi", "starlette", "pydantic", "uvicorn"), "label"),
    "pymba": "camera",
    "av": "video",
    "vmbpy": "vimbax",
    "cryptography": "sign",
    **dict.fromkeys(("dask", "distributed", "psutil"), "cluster"),
    "threadpoolctl": "train",
}
"""The extra that brings a package, by the name it is imported by."""


class MissingExtraError(ToktError, ImportError):
    """A package is missing that an extra of tokt brings."""


def missing_extra(error: ModuleNotFoundError, who: str) -> MissingExtraError | None:
    """What to install where `who` needs a package that is not there; None for any other package."""
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    return MissingExtraError(f"{who} needs {package}: install tokt[{EXTRAS[package]}]")


@contextmanager
def needed_by(who: str) -> Iterator[None]:
    """Around imports that an extra may have to bring."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_extra(error, who)
        if missing is None:
            raise
        raise missing from None
