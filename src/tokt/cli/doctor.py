"""`tokt doctor`: versions, extras, kernels in use, camera driver, store and registry health."""

import re
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError, printable
from tokt.features.common.terminal import say
from tokt.features.common.workspace import DEFAULT_WORKSPACE

from .options import JsonOption, WorkspaceOption
from .output import answer
from .output import print_line as print

_FAULTY = 1
_LITTLE_BYTES = 1e9
_STYLES = {OK: "green", NOTE: "yellow", FAULT: "bold red"}
_NO_USER_S = {"all", "demo", "dev", "docs", "release"}
"""Extras of the checkout, and the sum of all others."""
_REQUIREMENT = r"([A-Za-z0-9._-]+)(?:\[([^\]]*)\])?"
_OF_EXTRA = r"""extra\s*==\s*["']([^"']+)["']"""


def doctor(
    store: Annotated[Path | None, Option(help="Store to check as well.")] = None,
    support: Annotated[
        Path | None,
        Option(metavar="FILE", help="Pack what a colleague needs to see into this zip file."),
    ] = None,
    config: Annotated[
        Path | None, Option(help="Pack this run's configuration, logs and store as well.")
    ] = None,
    frames: Annotated[
        bool, Option("--frames", help="Pack the last recorded frames as well.")
    ] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Check versions, kernels, camera drivers, store and registry.

    Every line is ok, a note (worth knowing, perhaps as intended) or a fault. Exit code 1: a fault.
    Nothing on disk is changed but the file of --support. It holds no keys, tokens or passwords.
    """
    if support is None and (config or frames):
        raise ToktError("--config and --frames go with --support")
    if frames and config is None:
        raise ToktError("--frames needs --config, which names the recording")
    findings = _findings(store, workspace)
    if support is not None:
        from .support import write_support

        packed = write_support(support, findings, store, config, frames)
        say(f"{support} holds {', '.join(packed.names)}")
        for fault in packed.faults:
            say(f"not in it: {fault}")
        say(f"left out: keys, tokens, passwords in addresses{'' if frames else ', frames'}")
    ok = all(finding.state != FAULT for finding in findings)
    value = {"ok": ok, "findings": [finding.to_json() for finding in findings]}
    answer(json, value, lambda: _print(findings))
    if not ok:
        raise typer.Exit(_FAULTY)


def _findings(store: Path | None, workspace: Path) -> list[Finding]:
    found: list[Finding] = []
    with _examined("installation", found):
        found.extend(_installation())
    # The kernels come before all that needs them: see there what a wrong choice of them does.
    with _examined("kernels", found):
        from tokt.features.kernels.health import kernel_findings

        found.extend(kernel_findings())
    with _examined("camera driver", found):
        from tokt.inference.sources.cameras.vimba.system import camera_driver_finding

        found.append(camera_driver_finding())
    with _examined("Vimba X", found):
        from tokt.inference.sources.cameras.vimba.vimbax_system import vimbax_finding

        found.append(vimbax_finding())
    with _examined("genicam cameras", found):
        from tokt.inference.sources.cameras.genicam.producers import genicam_finding

        found.append(genicam_finding())
    if store is not None:
        with _examined("store", found):
            from tokt.models.store.health import store_findings

            found.extend(store_findings(store))
    with _examined("workspace", found):
        found.append(_disk(workspace))
    with _examined("labels", found):
        from tokt.labels.store.health import label_store_finding

        found.append(label_store_finding(workspace))
    with _examined("registry", found):
        from tokt.models.registry.health import registry_finding

        found.append(registry_finding(workspace))
    return found


@contextmanager
def _examined(name: str, found: list[Finding]) -> Iterator[None]:
    """One part; what keeps it from being examined is a finding, too."""
    try:
        yield
    except (ToktError, OSError, ImportError) as error:
        found.append(Finding(name, FAULT, f"cannot be examined: {' '.join(str(error).split())}"))


def _installation() -> Iterable[Finding]:
    """Versions and extras; an extra that was not asked for is no fault."""
    from importlib.metadata import metadata, version

    from tokt.features.common.machine import machine

    about = machine()
    yield Finding("tokt", OK, version("tokt"))
    yield Finding("python", OK, about["python"])
    yield Finding("machine", OK, f"{about['system']}, {about['cpu']}, {about['cores']} cores")
    yield _imported("numpy")
    yield _imported("opencv", "cv2")
    for extra in metadata("tokt").get_all("Provides-Extra", []):
        if extra not in _NO_USER_S:
            yield _video() if extra == "video" else _extra(extra)


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
        words = f"missing: {', '.join(missing)}"
        if extra == "train" and not missing_packages("tokt", "demo"):
            words += " (training works; MLflow's pages and the reference features need them)"
        return Finding(f"extra {extra}", NOTE, words, figures)
    return Finding(f"extra {extra}", OK, "complete", figures)


def _video() -> Finding:
    """The extra that reads network video and USB cameras, and FFmpeg's version in it."""
    found = _extra("video")
    if found.state != OK:
        return found
    from importlib.metadata import version

    import av

    ffmpeg = f"PyAV {av.__version__} with FFmpeg {av.ffmpeg_version_info}"
    return Finding(found.name, OK, f"{ffmpeg}, aiortsp {version('aiortsp')}", found.figures)


def missing_packages(package: str, extra: str) -> list[str]:
    """Names of the packages that an extra of an installed package asks for and that are absent."""
    from importlib.metadata import requires

    from tokt.features.common.machine import installed_version

    missing = []
    for line in requires(package) or []:
        wanted, of_extra = re.match(_REQUIREMENT, line), re.search(_OF_EXTRA, line)
        if wanted is None or of_extra is None or of_extra[1] != extra:
            continue
        name, own_extras = wanted[1], wanted[2]
        if installed_version(name) is None:
            missing.append(name)
        else:
            for own in filter(None, re.split(r"\s*,\s*", own_extras or "")):
                missing += missing_packages(name, own)
    return missing


def _disk(workspace: Path) -> Finding:
    """Room where the workspace is, or would be made."""
    whole = workspace.resolve()
    place = next(folder for folder in (whole, *whole.parents) if folder.is_dir())
    free = shutil.disk_usage(place).free
    text = f"{workspace}{'' if place == whole else ' (not made yet)'}: {free / 1e9:.1f} GB free"
    return Finding("workspace", OK if free >= _LITTLE_BYTES else NOTE, text, {"free_bytes": free})


def _print(findings: list[Finding]) -> None:
    """A table on a terminal, elsewhere a line a finding."""
    if not sys.stdout.isatty():
        for finding in findings:
            print(f"{finding.state:5}  {finding.name}: {finding.text}")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for finding in findings:
        state = Text(finding.state, _STYLES[finding.state])
        table.add_row(state, Text(finding.name), Text(printable(finding.text), overflow="fold"))
    Console().print(table)
