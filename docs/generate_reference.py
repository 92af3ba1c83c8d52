"""The pages of the reference that are made from the code: ``python docs/generate_reference.py``.

It writes them into docs/reference, below what people wrote there. A test holds them to the code.
"""

import dataclasses
import importlib
import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import typer

import tokt
from tokt.cli.app import whole_app
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import OPTIONS, Option
from tokt.inference.monitoring.metrics import RunCollector
from tokt.inference.monitoring.run_counts import CountingParts, RunCounts
from tokt.inference.reason import Reason
from tokt.inference.recording.run_start import ModelName
from tokt.inference.report import LOG_ONLY, MEANINGS, SINCE, V1_FIELDS, V2_FIELDS, ReportField

REFERENCE = Path(__file__).parent / "reference"
MADE = "<!-- Made by docs/generate_reference.py, from here to the end. -->\n"
PYTHON_MODULES = ("tokt", "tokt.sklearn", "tokt.mlflow")
"""Those whose public names (`__all__`) the Python page shows."""
STEPS = {
    "features": "Missions and frames",
    "labels": "Labels",
    "training": "Datasets, training and comparison",
    "models": "Models and stores",
    "inference": "The runtime",
    "cli": "A whole run",
    "studies": "Rendered missions",
    "errors": "Errors",
}
"""Headings of tokt's own names, by the folder they come from."""
OPTIONS_OF = {
    "DatasetOptions": "dataset build",
    "TrainOptions": "train",
    "CompareOptions": "compare",
    "EvaluateOptions": "evaluate",
}
"""Classes that hold the options of a command."""
FORMATS = {
    "features.frames.view_mask.FORMAT_VERSION": "mask of a dive, `tokt-mask.json`",
    "models.bundle.bundle.FORMAT_VERSION": "bundle, `.tokt`",
    "models.sight.FORMAT_VERSION": "numbers of sight in a bundle's manifest, `sight`",
    "models.bundle.signature.FORMAT_VERSION": "signature of a bundle, its member `signature.json`",
    "models.store.history.FORMAT_VERSION": "history of a store, `history.jsonl`",
    "models.signing.trusted_keys.FORMAT_VERSION": "keys that a store trusts, `keys.json`",
    "models.registry.registry.RECIPE_VERSION": "recipe of a registered model, `recipe.json`",
    "models.registry.registration.FORMAT_VERSION": "hashes and signature of a registered model",
    "models.registry.registration.RECORD_VERSION": "record of a promotion or a deployment",
    "features.extractors.textures.SPEC_VERSION": "extractor spec",
    "features.frames.numbering.FORMAT": "numbers of a dive's frames, `tokt_frames.json`",
    "labels.store.schema.FORMAT": "label store, `labels.db`",
    "labels.store.known_missions.FORMAT": "missions of a workspace, `missions.json`",
    "labels.taxonomy.FORMAT": "taxonomy file, `taxonomy.toml`",
    "labels.formats.patch_folder.FORMAT": "folder of patches, `tokt_patches.json`",
    "labels.formats.box_attributes.FORMAT": "tokt's attributes in label files of other tools",
    "labels.formats.audit_csv.FORMAT": "label audit",
    "labels.page.suggestions.suggestion_table.FORMAT": "suggestions kept by the labelling page",
    "training.datasets.dataset.FORMAT_VERSION": "dataset version, `dataset.json`",
    "training.datasets.frame_rows.FORMAT_VERSION": "rows of features in a dataset, `.rows`",
    "training.compare.comparison.FORMAT_VERSION": "comparison, `tokt compare --json`",
    "training.search.space.SPACE_FORMAT": "space of a search, `space.toml`",
    "training.search.state.STATE_FORMAT": "state of a search",
    "inference.report.V2": "UDP v2 and the log's lines",
    "inference.replay.findings_file.FORMAT": "findings, `.geojson`",
    "inference.recording.run_start.FORMAT_VERSION": "start of a run in a log",
    "inference.recording.recording.RECORDING_FORMAT": "recording, `recording.jsonl`",
    "inference.replay.shadow.SHADOW_FORMAT": "log of a challenger, `--shadow-log`",
    "inference.stereo.calibration_files.FORMAT_VERSION": "stereo calibration, `.yml`",
    "tokt_studies.simulation.rendering.synthetic_mission.SCENE_FORMAT": "scene of `tokt simulate`",
    "tokt_studies.simulation.study.RESULTS_FORMAT": "results of `tokt simulate`",
    "tokt_studies.simulation.loop.track.TRACK_FORMAT": "flight of `tokt simulate --closed-loop`",
    "tokt_studies.thesis.report.FORMAT": "results of `tokt reproduce`",
}
"""The version of each file format: where it stands in the code, and what has it."""
_CODE = re.compile(r"(\d+) (.+?)(?=[;,] \d|\.?$)")
_KINDS = {
    bool: "true or false",
    int: "whole number",
    float: "number",
    list: "array",
    dict: "object",
}


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table of Markdown; its cells are Markdown."""
    heads = [*heads]
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def as_cell(text: str) -> str:
    """Plain words as Markdown for a cell: what looks like an option is code."""
    parts = re.split(r"(`[^`]+`)", " ".join(text.replace("``", "`").split()))
    for at in range(0, len(parts), 2):
        safe = re.sub(r"([*_<>|\[\]])", lambda sign: f"&#{ord(sign[0])};", parts[at])
        parts[at] = re.sub(r"(?<![\w-])(--?[a-z][\w-]*)", r"`\1`", safe)
    return "".join(parts)


def command_line() -> str:
    """Every command, as its help has it."""
    root = typer.main.get_command(whole_app())
    lines = ["# Command line", "", root.help, "", *_overview(root), ""]
    for name, command in _leaves(root, "tokt"):
        lines += _command(name, command)
    return "\n".join([*lines, "See [exit codes](exit_codes.md).", ""])


def _leaves(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    if not hasattr(command, "commands"):
        yield name, command
        return
    for each, below in _in_panels(command):
        yield from _leaves(below, f"{name} {each}")


def _in_panels(group: Any) -> list[tuple[str, Any]]:
    """The commands of a group as its help has them: by their headings."""
    shown = [(name, one) for name, one in group.commands.items() if not one.hidden]
    order = [*dict.fromkeys(_panel(one) for _, one in shown)]
    return sorted(shown, key=lambda item: order.index(_panel(item[1])))


def _panel(one: Any, default: str = "Commands") -> str:
    panel = getattr(one, "rich_help_panel", None)
    return panel if isinstance(panel, str) else default


def _overview(root: Any) -> list[str]:
    lines = []
    for panel, commands in groupby(_in_panels(root), lambda item: _panel(item[1])):
        rows = []
        for first, command in commands:
            for name, one in _leaves(command, f"tokt {first}"):
                summary = (one.help or "").partition("\n\n")[0]
                rows.append([f"[`{name}`](#{name.replace(' ', '-')})", as_cell(summary)])
        lines += ["", f"**{panel}**", "", table(["Command", ""], rows)]
    return lines


def _command(name: str, command: Any) -> list[str]:
    context = typer.Context(command, info_name=name)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    lines = [f"## {name}", "", f"```\n{usage}\n```", ""]
    lines += [as_cell(part) + "\n" for part in (command.help or "").split("\n\n")]
    panels: dict[str, list[list[str]]] = {}
    for param in command.params:
        record = param.get_help_record(context)
        if record is None or getattr(param, "hidden", False):
            continue
        argument = param.param_type_name == "argument"
        title = _panel(param, "Arguments" if argument else "Options")
        panels.setdefault(title, []).append([f"`{record[0].strip()}`", as_cell(record[1])])
    for title, rows in panels.items():
        lines += [table([title, ""], rows)]
    return lines


def config() -> str:
    """The keys of a run's configuration file."""
    lines = ["## Keys", ""]
    for section, options in groupby(OPTIONS.values(), attrgetter("section")):
        rows = [
            [f"`{each.key}`", _kind(each), _default(each)]
            + [as_cell(words) for words in (each.only.partition(" (")[0], each.text)]
            for each in options
        ]
        heads = ["key", "value", "default", "only for", "meaning"]
        lines += [f"### [{section}]", "", table(heads, rows)]
    return "\n".join(lines)


def _kind(each: Option) -> str:
    kind = _KINDS.get(each.kind, "path" if each.kind is not str else "text")
    kind = f"list of {kind}" if each.many else kind
    return f"{kind} `{each.metavar}`" if each.metavar else kind


def _default(each: Option) -> str:
    if each.default in (None, ""):
        return ""
    return f"`{str(each.default).lower() if each.kind is bool else each.default}`"


def report() -> str:
    """The fields of datagrams and logs."""
    since = [[str(version), as_cell(words)] for version, words in SINCE.items()]
    labels = ("status", "Xpos", "Ypos", "meanValue")
    v1 = [[f"`{label}`", f"`{each.name}`"] for label, each in zip(labels, V1_FIELDS, strict=True)]
    heads = ["field", "type", "unit", "since", "also", "meaning"]
    return f"""# Report fields

One report is made for each frame. [Datagrams](udp.md) carry it,
[logs](../how-to/logs_and_metrics.md#log) keep it.

## UDP v2

{table(heads, map(_field, V2_FIELDS))}
*since* is the version of this table that brought the field. Older datagrams and logs do not have
it. *also* names what else has it: v1, or a [metric](metrics.md) without its `tokt_`.

## UDP v1

{table(["v1", "field"], v1)}
## Log lines

A log's line has the fields of UDP v2, and these:

{table(heads, map(_field, LOG_ONLY))}
## Versions

{table(["since", "what came with it"], since)}"""


def _field(each: ReportField) -> list[str]:
    also = [*["v1"] * each.v1, *[f"`{each.metric}`"] * bool(each.metric)]
    kind = _KINDS.get(each.kind, "text") + " or null" * each.nullable
    cells = [f"`{each.name}`", kind, each.unit, str(each.since), ", ".join(also)]
    return [*cells, as_cell(MEANINGS[each.name])]


def reasons() -> str:
    """The codes of what was not as it should be."""
    rows = [[f"`{each}`", *map(as_cell, (each.meaning, each.advice))] for each in Reason]
    return f"""# Reasons

Why a verdict is unknown. With status 1 or 0, what the verdict had to do without.

{table(["reason", "what it says", "what to do"], rows)}"""


def exit_codes() -> str:
    """What a command's end says."""
    root = typer.main.get_command(whole_app())
    (listed,) = re.findall(r"Exit codes: (.*)", " ".join((root.epilog or "").split()))
    codes, _, more = listed.partition(". ")
    rows = [[f"`{code}`", as_cell(words)] for code, words in re.findall(_CODE, codes)]
    return f"# Exit codes\n\n{table(['code', 'meaning'], rows)}\n{more}\n"


def metrics() -> str:
    """The metrics of a run that has everything."""
    counts = RunCounts(SYSTEM_CLOCK)
    counts.verdicts["clear", "ok"] = 1
    counts.heartbeat_reasons["stale"] = counts.events["start"] = 1
    counts.model = ModelName("tower/3", "")
    counts.last_report = SimpleNamespace(verdict=SimpleNamespace(status=0))
    counters: Any = _Counters()
    collector = RunCollector(
        counts,
        SYSTEM_CLOCK,
        senders={"udp": counters},
        parts=CountingParts(log=counters, recorder=counters, cameras=counters),
        drift=counters,
        faults={"--log": "No space left on device"},
    )
    rows = []
    for metric in collector.collect():
        labels = dict.fromkeys(name for one in metric.samples for name in one.labels)
        labels.pop("le", None)
        name = f"{metric.name}_total" if metric.type == "counter" else metric.name
        shown = ", ".join(f"`{label}`" for label in labels)
        rows.append([f"`{name}`", metric.type, shown, as_cell(metric.documentation)])
    return f"""# Metrics

`tokt run --metrics PORT` serves them to Prometheus. Those of cameras, the recorder, the log and
drift are there where the run has these. A request has to name this computer or, where one is
given, the HOST of `HOST:PORT` or any IP address.

{table(["metric", "type", "labels", "meaning"], rows)}"""


class _Counters:
    """A part of a run that counts, of which every count is 1."""

    counts = drivers = property(lambda self: [self, self])
    writer = state = property(lambda self: self)
    distances = property(lambda self: {"f": 1.0})

    def __getattr__(self, name: str) -> float:
        return 1.0


def formats() -> str:
    """The versions of the file formats."""
    rows = [[words, str(_version(place))] for place, words in FORMATS.items()]
    head = "tokt writes these versions. It reads older ones, and refuses newer ones in one line."
    return f"## Versions of files\n\n{head}\n\n{table(['file', 'version'], rows)}"


def _version(place: str) -> int:
    module, _, name = place.rpartition(".")
    package = "" if module.startswith("tokt_studies.") else "tokt."
    return getattr(importlib.import_module(package + module), name)


def python(site: bool = False) -> str:
    """The public names and what each is; on the site mkdocstrings fills them in."""
    lines = [
        "# Python\n\n`import tokt` is quick: each name is loaded when it is first used.\n",
        "Names that read or train need the [extra](../install.md) that their error names.\n",
    ]
    if not site:
        lines += ["`help(tokt.Grid)` shows parameters and fields, and so does the site.\n"]
    for module in map(importlib.import_module, PYTHON_MODULES):
        anchor = f" {{ #module-{module.__name__} }}" if site else ""
        lines += [f"## {module.__name__}{anchor}", ""]
        if module is not tokt and site:
            lines += [f"::: {module.__name__}", "    options:", "      members: false"]
            lines += ["      show_root_heading: false", "      show_root_toc_entry: false", ""]
        placed = sorted(_place(module, name) for name in getattr(module, "__all__", ()))
        for step, group in groupby(placed, itemgetter(0)):
            lines += [f"### {[*STEPS.values()][step]}", ""] if module is tokt else []
            names = [name for *_, name in group]
            lines += _filled_in(module, names) if site else [_summaries(module, names)]
    return "\n".join(lines)


def _filled_in(module: Any, names: Iterable[str]) -> Iterator[str]:
    for name in names:
        yield from (f"::: {module.__name__}.{name}", "    options:", "      heading_level: 4")
        yield from ("", *_fields(getattr(module, name)), "")


def _summaries(module: Any, names: Iterable[str]) -> str:
    found = ((name, inspect.getdoc(getattr(module, name)) or "") for name in names)
    rows = [[f"`{name}`", as_cell(text.partition("\n\n")[0])] for name, text in found]
    return table(["name", "what it is"], rows)


def _place(module: Any, name: str) -> tuple[int, bool, str]:
    """Where a name stands: by the step it belongs to, functions first."""
    found = getattr(module, name)
    kind = isinstance(found, type)
    package, room, *_ = found.__module__.split(".")
    step = "studies" if package == "tokt_studies" else room
    step = "errors" if kind and issubclass(found, Exception) else step
    return [*STEPS].index(step) if module is tokt else 0, kind, name


def _fields(found: Any) -> list[str]:
    """What the fields of a dataclass mean: as a command's help, or the comments beside them say."""
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        return []
    names = [each.name for each in dataclasses.fields(found)]
    if found.__name__ in OPTIONS_OF:
        command = typer.main.get_command(whole_app())
        for word in OPTIONS_OF[found.__name__].split():
            command = command.commands[word]
        words = {param.name: param.help or "" for param in command.params}
    else:
        kinds = [one for one in found.__mro__[::-1] if dataclasses.is_dataclass(one)]
        words = {name: text for kind in kinds for name, text in _comments(kind)}
    rows = [[f"`{name}`", as_cell(words[name])] for name in names if words.get(name)]
    return [table(["Field", "Meaning"], rows)] if rows else []


def _comments(kind: type) -> Iterator[tuple[str, str]]:
    """The comments of a class's fields: behind each, or above it and those that follow it."""
    above, ended = "", True
    for line in inspect.getsource(kind).splitlines():
        if field := re.match(r"    (\w+): [^#]*(?:# (.*))?$", line):
            above, ended = "" if field[2] else above, True
            yield field[1], field[2] or above
        elif line.startswith("    # "):
            above, ended = line[6:] if ended else f"{above} {line[6:]}", False


PAGES: dict[str, Callable[[], str]] = {
    page.__name__: page
    for page in (command_line, config, report, reasons, exit_codes, metrics, formats, python)
}
"""What makes each page, by its name in docs/reference."""


def pages() -> dict[Path, str]:
    """Each page as it has to be: what people wrote at its beginning, and what is made."""
    found = {}
    for name, make in PAGES.items():
        path = REFERENCE / f"{name}.md"
        head = path.read_text("utf-8").partition(MADE)[0] if path.exists() else ""
        found[path] = head + MADE + re.sub(r"\n{3,}", "\n\n", f"\n{make().strip()}\n")
    return found


if __name__ == "__main__":
    for page, text in pages().items():
        page.write_text(text, "utf-8", newline="\n")
