"""Missions as users name them: ``[NAME=]DIR``, or a list of several with labels, site and date.

A list is ``missions.toml``, or another file of that ending; its paths start from its folder::

    [[mission]]
    name = "approach"                  # what labels, datasets and reports call it
    dir = "2016-04-20/frames"          # a folder or a video
    labels = ["ann.csv", "ben.csv"]    # or one file; without any: those of the command
    cameras = ["left"]                 # whose labels count; without any: all
    site = "Trondheimsfjorden"         # dives that share a water and a camera
    date = 2016-04-20
"""

import tomllib
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError, os_errors_as
from tokt.features.frames.mission import LEFT, RIGHT, named_path

LIST_FILE = "missions.toml"
_TEXTS = ("name", "dir", "site", "date")
_LISTS = ("labels", "cameras")


@dataclass(frozen=True)
class NamedMission:
    """A mission as a user named it; not opened yet."""

    path: Path
    name: str | None = None  # None where its folder's or file's own name is meant
    labels: tuple[Path, ...] = ()  # its own label files
    cameras: tuple[str, ...] = ()  # the cameras whose labels count; empty for all
    site: str = ""  # empty where not said, as the date
    date: str = ""


def named_missions(text: Path | str) -> list[NamedMission]:
    """Read what stands after ``--mission``: one mission, or a list (or a folder with one in it).

    Raises ToktError if a list cannot be read, or says what it must not.
    """
    name, path = named_path(text)
    listed = path / LIST_FILE if (path / LIST_FILE).is_file() else path
    if listed.suffix != Path(LIST_FILE).suffix or listed.is_dir():
        return [NamedMission(path, name)]
    if name is not None:
        raise ToktError(f"{listed} has the missions' names in it: give it without {name}=")
    try:
        with os_errors_as(str(listed)):
            value = tomllib.loads(listed.read_text("utf-8"))
    except UnicodeDecodeError:
        raise ToktError(f"{listed}: not UTF-8 text") from None
    except (ValueError, RecursionError) as error:  # not TOML, 5,000 digits, 1,000 brackets
        raise ToktError(f"{listed}: {error}") from None
    tables = value.get("mission")
    if set(value) != {"mission"} or not isinstance(tables, list) or not tables:
        raise ToktError(f"{listed}: a list of missions has [[mission]] tables and nothing else")
    return [_mission(table, listed, n) for n, table in enumerate(tables, 1)]


def _mission(table: Any, file: Path, number: int) -> NamedMission:
    where = f"{file}: mission {number}"
    if not isinstance(table, dict):
        raise ToktError(f"{where} is not a [[mission]] table")
    for key, value in table.items():
        if key not in (*_TEXTS, *_LISTS):
            raise ToktError(f"{where}: unknown key {key!r}; known: {', '.join((*_TEXTS, *_LISTS))}")
        texts = value if key in _LISTS and isinstance(value, list) else [value]
        kinds = (str, date) if key == "date" else (str,)
        if not all(isinstance(text, kinds) and text and "\0" not in str(text) for text in texts):
            raise ToktError(f"{where}: {key} is text, not {value!r}")
    if not {"name", "dir"} <= set(table):
        raise ToktError(f"{where} needs a name and a dir")
    both = (table.get(key, []) for key in _LISTS)
    labels, cameras = ([value] if isinstance(value, str) else value for value in both)
    if not set(cameras) <= {LEFT, RIGHT}:
        raise ToktError(f"{where}: cameras are {LEFT} and {RIGHT}, not {', '.join(cameras)}")
    return NamedMission(
        file.parent / table["dir"],
        table["name"],
        tuple(file.parent / path for path in labels),
        tuple(cameras),
        table.get("site", ""),
        str(table.get("date", "")),
    )
