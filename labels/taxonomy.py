"""The classes a patch can have, read from a taxonomy file that users may extend."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError, naming
from tokt.features.common.names import same_text

FORMAT = 2
"""Format of taxonomy files. Raise it when an older `tokt` would misread a newer file.

Parents and names with blanks are of format 2; without them 1 is written, which older ones read.
"""

FILE_NAME = "taxonomy.toml"

UNSURE = "unsure"
"""A person looked at the patch and could not decide: never trained or scored on, never a class."""
UNSURE_KEY = "u"

_NAME = re.compile(r"[^\W\d_][\w-]*(?: [\w-]+)*")
_COLOR = re.compile(r"#[0-9a-fA-F]{6}")


class UnknownClassError(ToktError):
    """A label is no class; `names` has all such labels that were found."""

    def __init__(self, message: str, names: Iterable[str]) -> None:
        super().__init__(message)
        self.names = sorted(names)


@dataclass(frozen=True)
class LabelClass:
    """One class of a taxonomy."""

    name: str  # what label records, datasets and models carry
    obstacle: bool  # whether the vehicle could hit it
    color: str  # ``#rrggbb``
    key: str  # the one character that chooses it on the labelling page
    description: str = ""  # what a person should look for
    parent: str = ""  # the class, or the name of the group, that it is a kind of; empty for none


@dataclass(frozen=True)
class Taxonomy:
    """The classes in their order, which is the order of confusion matrices and model outputs.

    Raises
    ------
    ToktError
        If two classes share a name or a key, or no class (or every class) is an obstacle. If a
        class is its own ancestor, or is clear while its parent is an obstacle.
    """

    classes: tuple[LabelClass, ...]

    def __post_init__(self) -> None:
        for what, values in (
            ("are named", self.names),
            ("have the key", tuple(known.key for known in self.classes)),
        ):
            for value in values:
                if values.count(value) > 1:
                    raise ToktError(f"two classes {what} {value!r}")
        if len({known.obstacle for known in self.classes}) != 2:
            raise ToktError("there must be a class with obstacle = true and one with false")
        by_name = {known.name: known for known in self.classes}
        for known in self.classes:
            above, met = by_name.get(known.parent), {known.name}
            if above and above.obstacle and not known.obstacle:
                raise ToktError(f"class {known.name!r} is clear, its parent {above.name!r} is not")
            while above:
                if above.name in met:
                    raise ToktError(f"class {known.name!r} is among its own parents")
                met.add(above.name)
                above = by_name.get(above.parent)

    @classmethod
    def load(cls, path: Path | None = None) -> Taxonomy:
        """Read a taxonomy file; ``None`` reads the one that comes with `tokt`.

        Raises
        ------
        ToktError
            If the file cannot be read or what it says is not a taxonomy; names the file.
        """
        source = resources.files(__package__) / FILE_NAME if path is None else path
        try:
            value = tomllib.loads(same_text(source.read_text("utf-8")))
        except OSError as error:
            raise ToktError(f"taxonomy {source}: {error.strerror or error}") from None
        except UnicodeDecodeError:
            raise ToktError(f"taxonomy {source}: not UTF-8 text") from None
        except (ValueError, RecursionError) as error:  # not TOML, 5,000 digits, 1,000 brackets
            raise ToktError(f"taxonomy {source}: {error}") from None
        return cls.from_json(value, f"taxonomy {source}")

    @classmethod
    def from_json(cls, value: Any, where: str = "taxonomy") -> Taxonomy:
        """Read what `to_json` wrote; `where` begins the error message.

        Raises
        ------
        ToktError
            If `value` is not a taxonomy of a format this version reads.
        """
        with naming(where):
            return _parse(value)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form, as dataset versions embed it."""
        plain = all(not known.parent and " " not in known.name for known in self.classes)
        tables = [asdict(known) for known in self.classes]
        for table in tables:
            if not table["parent"]:
                del table["parent"]
        return {"format": 1 if plain else FORMAT, "classes": tables}

    def to_toml(self) -> str:
        """The text of a taxonomy file."""
        value = self.to_json()
        parts = [f"format = {value['format']}\n"]
        for table in value["classes"]:
            # TOML's strings are JSON's, which leaves one sign as it is that TOML does not.
            told = [
                f"{key} = {json.dumps(said, ensure_ascii=False)}" for key, said in table.items()
            ]
            parts.append("\n".join(["[[classes]]", *told, ""]).replace("\x7f", "\\u007f"))
        return "\n".join(parts)

    @property
    def names(self) -> tuple[str, ...]:
        """Class names in order, without ``unsure``."""
        return tuple(known.name for known in self.classes)

    def is_obstacle(self, name: str) -> bool:
        """Whether class `name` is something the vehicle could hit.

        Raises
        ------
        ToktError
            If there is no such class (``unsure`` is none).
        """
        for known in self.classes:
            if known.name == name:
                return known.obstacle
        raise ToktError(f"unknown class {name!r}; known: {', '.join(self.names)}")

    def check_label(self, label: str) -> None:
        """Raise UnknownClassError unless `label` is a class or ``unsure``."""
        if label != UNSURE and label not in self.names:
            known = ", ".join((*self.names, UNSURE))
            raise UnknownClassError(
                f"unknown class {label!r}; known: {known}; to add one, append a [[classes]] table"
                f" to {FILE_NAME} in the workspace, or give --taxonomy FILE",
                [label],
            )


def load_taxonomy(workspace: Path | None = None, file: Path | None = None) -> Taxonomy:
    """The taxonomy of `file`, or the workspace's, or the packaged one; ToktError if unusable."""
    if file is None and workspace is not None and (workspace / FILE_NAME).is_file():
        file = workspace / FILE_NAME
    return Taxonomy.load(file)


def _parse(value: Any) -> Taxonomy:
    if not isinstance(value, Mapping):
        raise ToktError("not a table of format and classes")
    version = value.get("format")
    if type(version) is not int or version < 1:
        raise ToktError('the first line must be "format = 1"')
    if version > FORMAT:
        raise ToktError(f"format {version} is newer than this tokt reads ({FORMAT}); update tokt")
    unknown = sorted(set(value) - {"format", "classes"})
    if unknown:
        raise ToktError(f"unknown field {unknown[0]!r}")
    tables = value.get("classes")
    if not isinstance(tables, list) or not tables:
        raise ToktError("no [[classes]] in it")
    return Taxonomy(tuple(_parse_class(table, n) for n, table in enumerate(tables, 1)))


def _parse_class(table: Any, number: int) -> LabelClass:
    if not isinstance(table, Mapping):
        raise ToktError(f"class {number} is not a table")
    where = f"class {table.get('name', number)!r}"
    for field in fields(LabelClass):
        kind, text = (bool, "true or false") if field.name == "obstacle" else (str, "text")
        if field.name not in table and field.name not in ("description", "parent"):
            raise ToktError(f"{where} has no {field.name}")
        if not isinstance(table.get(field.name, ""), kind):
            raise ToktError(f"{where}: {field.name} must be {text}")
    unknown = sorted(set(table) - {field.name for field in fields(LabelClass)})
    if unknown:
        raise ToktError(f"{where} has an unknown field {unknown[0]!r}")
    known = LabelClass(**table)
    _check_class(known, where)
    return known


def _check_class(known: LabelClass, where: str) -> None:
    if known.name == UNSURE:
        raise ToktError(f"{UNSURE!r} cannot be a class: it marks what a person could not decide")
    if not _NAME.fullmatch(known.name):
        raise ToktError(f"{where}: a name is a letter, then letters, digits, single blanks, _ or -")
    if known.parent and (known.parent == UNSURE or not _NAME.fullmatch(known.parent)):
        raise ToktError(f"{where}: parent {known.parent!r} is no name of a class or a group")
    if not _COLOR.fullmatch(known.color):
        raise ToktError(f"{where}: color {known.color!r} is not of the form #rrggbb")
    if len(known.key) != 1 or not known.key.isprintable() or known.key == " ":
        raise ToktError(f"{where}: key {known.key!r} is not one character")
    if known.key == UNSURE_KEY:
        raise ToktError(f"{where}: key {UNSURE_KEY!r} is kept for {UNSURE!r}")
