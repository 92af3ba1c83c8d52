"""State of a search on disk: killed at any instant, it goes on where it was.

Below the workspace::

    searches/KEY/search.json            format, id, what is searched and by which rule
    searches/KEY/trials/ID.json         one finished trial
    searches/KEY/nested/FOLD-ID.json    one trial inside the training part of an outer fold
    searches/KEY/winner.json            the winner's spec, for --extractor spec:FILE
    searches/KEY/result.json            what the command reported last

KEY is a hash over dataset, space, folds, rule and the code and libraries that decide a score, so
that no result of another question is ever taken for one of this. Every file appears whole or
not at all.

To change the format: raise STATE_FORMAT, keep reading the old one, prove it with a test.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from tokt.features.common import atomic
from tokt.features.common.atomic import locked
from tokt.features.common.canonical import json_sha256
from tokt.features.common.errors import ToktError, check_format
from tokt.training.fitting.presets import Hyperparameters

from .score import BlockConfusion

STATE_FORMAT = 1
_KEY_CHARS = 16
_T = TypeVar("_T")


@dataclass(frozen=True)
class Finished:
    """A trial's outcome."""

    tally: BlockConfusion
    choices: tuple[Hyperparameters, ...]  # C and class weight of each fold
    seconds: float  # what it took; for people


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file for people and machines, whole or not at all."""
    atomic.write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")


def write_finished(path: Path, finished: Finished) -> None:
    """Keep a finished trial."""
    choices = [[choice.penalty, choice.class_weight] for choice in finished.choices]
    value = {"format": STATE_FORMAT, "choices": choices, "seconds": round(finished.seconds, 3)}
    write_json(path, {**value, "tally": finished.tally.to_json()})


def read_finished(path: Path) -> Finished | None:
    """A trial kept earlier, if any; ToktError where it is damaged or of a newer format."""
    return _read(path, _finished, "delete it, or search with --fresh")


def _finished(value: dict[str, Any]) -> Finished:
    choices = tuple(Hyperparameters(float(penalty), weight) for penalty, weight in value["choices"])
    return Finished(BlockConfusion.from_json(value["tally"]), choices, float(value["seconds"]))


def _read(path: Path, parsed: Callable[[dict[str, Any]], _T], remedy: str) -> _T | None:
    """What `parsed` makes of a JSON file of this format, or None where there is none."""
    try:
        value = json.loads(path.read_text("utf-8"))
        check_format(value["format"], STATE_FORMAT, str(path))
        return parsed(value)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError):
        raise ToktError(f"{path} is damaged; {remedy}") from None


@dataclass(frozen=True)
class SearchState:
    """The folder of one search."""

    folder: Path
    id: str  # names the search in the registry: its key, and a number that ``--fresh`` raises

    def trial_file(self, trial_id: str, outer_fold: int | None = None) -> Path:
        """Where a finished trial is kept; with `outer_fold`, that of its training part."""
        if outer_fold is None:
            return self.folder / "trials" / f"{trial_id}.json"
        return self.folder / "nested" / f"{outer_fold}-{trial_id}.json"


@contextmanager
def opened_state(
    root: Path, question: Mapping[str, Any], dataset: str, *, fresh: bool
) -> Iterator[SearchState]:
    """The state of a search as an earlier run left it, if not `fresh`, for this process alone.

    `root` is the workspace's ``searches`` folder; the dataset's name begins the search's own. The
    question is all that can change a trial's score or the winner.

    Raises ToktError if another process is at the same search, or the state is damaged or of a newer
    format.
    """
    key = f"{dataset}-{json_sha256(question)[:_KEY_CHARS]}"
    folder = root / key
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        try:
            held.enter_context(locked(folder / "lock", 0.0))
        except ToktError:
            raise ToktError(f"{folder}: another process is at this search already") from None
        for part in (folder, folder / "trials", folder / "nested"):
            atomic.remove_partials(part)
        yield SearchState(folder, f"{key}.{_number(folder, question, fresh)}")


def _number(folder: Path, question: Mapping[str, Any], fresh: bool) -> int:
    """The number of the search that goes on, or of one that begins."""
    file, remedy = folder / "search.json", "delete its folder to search anew"
    earlier = _read(file, lambda header: int(header["number"]), remedy)
    if earlier is not None and not fresh:
        return earlier
    for part in (folder / "trials", folder / "nested"):
        if part.exists():
            shutil.rmtree(part)
    number = 1 + (earlier or 0)
    write_json(file, {"format": STATE_FORMAT, "number": number, "question": question})
    return number
