"""The models that judged in a run, found again by their bundles' SHA-256."""

from __future__ import annotations

from pathlib import Path

from tokt.features.common.errors import ToktError
from tokt.inference.recording.run_start import ModelName
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.store.store import Store

from .logged_run import LoggedRun


def models_of_run(run: LoggedRun, store: Path | None = None) -> dict[str, Bundle]:
    """Every model that judged in a run, by SHA-256.

    Parameters
    ----------
    run : LoggedRun
    store : Path, optional
        Where they are looked for; by default where the run had them from.

    Raises
    ------
    ToktError
        If one is not there any more, or fails its checks.
    """
    place = store or (Path(run.start.models_from) if run.start.models_from else None)
    return {name.sha256: _found(name, place) for name in run.models}


def model_named(place: Path) -> Bundle:
    """The model of a bundle file, or the active one of a store.

    Raises
    ------
    ToktError
        If there is none, or it fails its checks.
    """
    return Store(place).active() if place.is_dir() else read_bundle(place)


def _found(name: ModelName, place: Path | None) -> Bundle:
    if place is None:
        raise ToktError(f"where model {name.label} is the log does not say (--store STORE)")
    if place.is_dir():
        return Store(place).bundle(name.sha256)
    bundle = read_bundle(place)
    if bundle.sha256 != name.sha256:
        raise ToktError(
            f"{place} is not the bundle that ran: it is {bundle.label} {bundle.sha256[:12]}, the "
            f"run's was {name.label} {name.sha256[:12]} (--bundle {place} judges with it all the "
            "same)"
        )
    return bundle
