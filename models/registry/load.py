"""Loading a model by any name a command takes; a bundle file and a store need no registry."""

from pathlib import Path
from typing import Any

from tokt.features.common.extras import needed_by
from tokt.models.bundle.bundle import SUFFIX, Bundle, read_bundle
from tokt.models.pretrained.packaged import is_packaged, packaged_bundle
from tokt.models.store.store import Store


def load_model(reference: str | Path, workspace: str | Path = ".tokt", **checks: Any) -> Bundle:
    """Load a model, with all checks of its bundle.

    Parameters
    ----------
    reference : str or Path
        A ``.tokt`` file, a store's folder (its active model), ``waters``, which comes with tokt,
        ``NAME`` (the newest version), ``NAME@ALIAS`` or ``NAME/VERSION``.
    workspace : str or Path
        Folder whose registry has the named models.
    checks
        Those of `Registry.bundle`; a file was checked by whoever exported it.

    Returns
    -------
    Bundle

    Raises
    ------
    ToktError
        If there is none, or it fails a check.

    Examples
    --------
    >>> model = tokt.load_model("tower-lbp-1.tokt")  # doctest: +SKIP
    >>> tokt.judge_image(model, picture).verdict.status  # doctest: +SKIP
    1
    """
    if is_packaged(reference):
        return read_bundle(packaged_bundle(str(reference)))
    if not is_registered_name(reference):
        is_file = str(reference).endswith(SUFFIX)
        return read_bundle(reference) if is_file else Store(reference).active()
    with needed_by(f"the model {reference}"):
        from .registry import Registry
    return Registry(Path(workspace)).bundle(str(reference), **checks)


def is_registered_name(reference: str | Path) -> bool:
    """Whether a registry is asked for it: not a file, a store's folder or a model of tokt's own."""
    file_or_store = str(reference).endswith(SUFFIX) or Store(reference).is_there
    return not is_packaged(reference) and not file_or_store
