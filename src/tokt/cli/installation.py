"""Findings of `tokt doctor` about the installation: versions, the machine, the extras."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from tokt.features.common.errors import FAULT, NOTE, OK, Finding
from tokt.features.common.machine import machine

EXTRAS = ("train", "label", "camera", "cluster")

_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[([^\]]*)\])?")
_OF_EXTRA = re.compile(r"""extra\s*==\s*["']([^"']+)["']""")


def installation_findings() -> Iterator[Finding]:
    """Versions and extras; an extra that was not asked for is no fault."""
    about = machine()
    yield Finding("tokt", OK, version("tokt"))
    yield Finding("python", OK, about["python"])
    yield Finding("machine", OK, f"{about['system']}, {about['cpu']}, {about['cores']} cores")
    yield _imported("numpy")
    yield _imported("opencv", "cv2")
    yield from map(_extra, EXTRAS)


def _imported(name: str, module: str = "") -> Finding:
    try:
        found = __import__(module or name)
    except ImportError as error:
        return Finding(name, FAULT, f"cannot be imported: {' '.join(str(error).split())}")
    return Finding(name, OK, str(found.__version__))


def _extra(extra: str) -> Finding:
    missing = missing_packages("tokt", extra)
    figures = {"missing": missing}
    if missing:
        text = f"missing: {', '.join(missing)} (pip install 'tokt[{extra}]')"
        return Finding(f"extra {extra}", NOTE, text, figures)
    return Finding(f"extra {extra}", OK, "complete", figures)


def missing_packages(package: str, extra: str) -> list[str]:
    """Names of the packages that an extra of an installed package asks for and that are absent."""
    missing = []
    for line in requires(package) or []:
        wanted, of_extra = _REQUIREMENT.match(line), _OF_EXTRA.search(line)
        if wanted is None or of_extra is None or of_extra[1] != extra:
            continue
        name, own_extras = wanted[1], wanted[2]
        try:
            version(name)
        except PackageNotFoundError:
            missing.append(name)
        else:
            for own in filter(None, re.split(r"\s*,\s*", own_extras or "")):
                missing += missing_packages(name, own)
    return missing
