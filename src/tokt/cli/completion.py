"""Completion of values in a shell: choices, and names out of the workspace."""

import re
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any

_BREAKS = "@:="  # where bash parts words, beside blanks
_CHOICE = re.compile(r"[a-z][a-z0-9_-]*")
_parted = False


def join_bash_words(environment: MutableMapping[str, str]) -> None:
    """Put together again what bash parted, such as NAME@ALIAS, in what it tells of its line."""
    global _parted
    words = environment["COMP_WORDS"].split("\n")
    current = last = int(environment["COMP_CWORD"])
    joined: list[str] = []
    glue = False
    for number, word in enumerate(words):
        is_break = bool(word) and not word.strip(_BREAKS)
        if joined and (glue or is_break):
            joined[-1] += word
            current -= number <= last
        else:
            joined.append(word)
        glue = is_break
    _parted = not joined[current].startswith(('"', "'"))  # it parts nothing in quotes
    environment.update(COMP_WORDS="\n".join(joined), COMP_CWORD=str(current))


def complete(context: Any, param: Any, incomplete: str) -> list[str]:
    """What a value can become, by its name in the help; nothing where that is a file's."""
    known = dict.fromkeys(_values(param.metavar.rstrip("."), context, incomplete))
    # Bash puts what it is told in the place of the last part alone, which an @ belongs to.
    last = max(0, incomplete.rfind("@"), incomplete.rfind(":") + 1, incomplete.rfind("=") + 1)
    cut = last if _parted else 0
    # One with a blank would be two words: a shell completes a file's name itself, and quotes it.
    whole = (value for value in known if " " not in value)
    return [value[cut:] for value in whole if value.startswith(incomplete)]


def _values(name: str, context: Any, incomplete: str) -> Iterator[str]:
    workspace = Path(context.params.get("workspace") or ".tokt")  # a text as yet
    for kind in name.split("|"):
        if kind == "DATASET":
            latest = (workspace / "datasets").glob("*/latest")
            yield from sorted(file.parent.name for file in latest)
        elif kind in ("MODEL", "ALIAS"):
            from tokt.models.registry.names import ALIASES, REFERENCES, registered_names

            yield from registered_names(workspace, REFERENCES if kind == "MODEL" else ALIASES)
            if kind == "MODEL":
                yield from sorted(map(str, Path().glob("?*.tokt")))
        elif kind == "EXTRACTOR":
            from tokt.features.extractors.named_extractors import NAMED

            before = incomplete[: incomplete.rfind("+") + 1]
            yield from (before + one for one in NAMED)
        elif _CHOICE.fullmatch(kind):
            yield kind
