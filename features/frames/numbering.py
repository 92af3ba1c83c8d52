"""Order, pairs and numbers of a mission's picture files, by their whole names.

A number in a name is no time, and may be there twice: ``T1-01.jpg`` and ``T2-01.jpg``, or pictures
named by seconds and fractions of them. Files are ordered by all the numbers in their names, and
then by the text. A left and a right picture are a pair where their names are the same, but for what
is the same in all names of a camera.

A frame's number is the one that its file's name ends in, where this tells all frames apart. Where
it does not, numbers are given once, and kept beside the frames as ``tokt_frames.json``::

    {"format": 1, "numbers": {"left": {"T1-01.jpg": 1, "T2-01.jpg": 2}}}
"""

import itertools
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.atomic import write_text
from tokt.features.common.errors import ToktError, check_format
from tokt.features.common.names import same_text

RECORD = "tokt_frames.json"
FORMAT = 1
"""To change the format: raise this, keep reading the older ones, and prove it with a test."""
LAST_FRAME = 2**63 - 1
"""The largest number: nanoseconds since 1970 fit, and databases and tables hold it."""

_SMALL = 10**9  # numbers that are given are no larger, whatever names end in
_AT_END = re.compile(r"[0-9]+$")
_NUMBERS = re.compile(r"[0-9]{9,}\.[0-9]+|[0-9]+")  # seconds since 1970 with a fraction, or any
_PARTS = re.compile(r"[0-9]+|[^0-9]+")
_SIDES = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])")

Files = dict[str, list[Path]]
"""Picture files of each camera."""
Numbers = Mapping[str, Mapping[str, int]]
"""Numbers of files, by camera and file name."""
Key = tuple[object, ...]


def natural_order(path: Path) -> tuple[list[tuple[int, str]], str, str]:
    """Return what a file is sorted by: all numbers in its name as numbers, then the text.

    ``CAM-1_20190513_235950`` is before ``CAM-1_20190514_000000``, and ``1461155400.923`` before
    ``1461155401.1``.
    """
    stem = same_text(path.stem)
    numbers = [text.partition(".") for text in _NUMBERS.findall(stem)]
    # A fraction is compared digit by digit: .25 is before .5.
    return [(int(whole), part) for whole, _, part in numbers], stem.casefold(), path.name


@dataclass(frozen=True)
class NumberedFiles:
    """A mission's picture files by frame number."""

    by_camera: dict[str, dict[int, Path]]  # of each camera in the dive's order
    places: dict[int, int]  # of each frame number in the dive, from 0, over all cameras


def numbered_files(mission: Path, files: Files, known: Numbers | None = None) -> NumberedFiles:
    """Number a mission's files.

    Files that are `known` by a number, in a label store, have it for good from now on.

    Raises ToktError if the mission's record of numbers is damaged or of a newer format.
    """
    order = {path: natural_order(path) for paths in files.values() for path in paths}
    files = {camera: sorted(paths, key=order.__getitem__) for camera, paths in files.items()}
    keys = _keys(files)
    given = known or _read_record(mission)
    numbers = None if given else _numbers_in_names(files, keys)
    if numbers is None:
        in_order = sorted((order[path], camera, path) for camera in files for path in files[camera])
        frames = dict.fromkeys(keys[camera][same_text(path.name)] for _, camera, path in in_order)
        numbers = _given_numbers(list(frames), keys, given)
        kept = {camera: _with_gone(given.get(camera, {}), some) for camera, some in numbers.items()}
        if known or {**given, **kept} != given:
            _keep_record(mission, {**given, **kept})
    found = {
        camera: {numbers[camera][same_text(path.name)]: path for path in paths}
        for camera, paths in files.items()
    }
    first = {number: path for side in reversed(found.values()) for number, path in side.items()}
    ranked = sorted(first, key=lambda number: order[first[number]])
    return NumberedFiles(found, {number: place for place, number in enumerate(ranked)})


def _with_gone(given: Mapping[str, int], numbers: Mapping[str, int]) -> dict[str, int]:
    """Add the numbers of files that are gone, which are no other file's from now on."""
    taken = set(numbers.values())
    gone = {name: n for name, n in given.items() if name not in numbers and n not in taken}
    return {**gone, **numbers}


def _keys(files: Files) -> dict[str, dict[str, Key]]:
    """Return what the two files of a pair have in common, by camera and file name.

    No two files of a camera have it in common, such as ``a_1.jpg`` and ``a_1.png``.
    """
    if len(files) == 1:
        return {
            camera: {(name := same_text(path.name)): (name,) for path in paths}
            for camera, paths in files.items()
        }
    found = {}
    for camera, some in _common_parts(files).items():
        times = Counter(some.values())
        found[camera] = {
            name: key if times[key] == 1 else (*key, name) for name, key in some.items()
        }
    return found


def _common_parts(files: Files) -> dict[str, dict[str, Key]]:
    parts = {
        camera: {same_text(path.name): _split(path) for path in paths}
        for camera, paths in files.items()
    }
    shapes = Counter(_shape(each) for some in parts.values() for each in some.values())
    usual = max(sorted(shapes, key=len), key=shapes.__getitem__)
    alike = [[each for each in some.values() if _shape(each) == usual] for some in parts.values()]
    several = [some for some in alike if len(some) > 1]
    told = [
        any(len({each[at] for each in some}) > 1 for some in several) for at in range(len(usual))
    ]

    def key(each: list[int | str]) -> Key:
        if not several or _shape(each) != usual:
            return _without_side(each)
        return tuple(part for part, tells in zip(each, told, strict=True) if tells)

    return {
        camera: {name: key(each) for name, each in some.items()} for camera, some in parts.items()
    }


def _shape(parts: list[int | str]) -> tuple[type, ...]:
    """Which of a name's parts are numbers."""
    return tuple(type(part) for part in parts)


def _without_side(parts: list[int | str]) -> Key:
    """A name's parts without the words that say which camera it is of."""
    cameras = (place for place, part in enumerate(parts) if str(part).endswith("cam"))
    numbers = {place + 1 for place in cameras}
    return tuple(
        part if isinstance(part, int) else _SIDES.sub("", part)
        for place, part in enumerate(parts)
        if place not in numbers
    )


def _split(path: Path) -> list[int | str]:
    stem = same_text(path.stem).casefold()
    return [int(part) if part[0] in "0123456789" else part for part in _PARTS.findall(stem)]


def _number(name: str) -> int | None:
    """The number that a file's name ends in, where one does that a table can hold."""
    match = _AT_END.search(Path(name).stem)
    number = int(match[0]) if match and len(match[0]) <= len(str(LAST_FRAME)) else None
    return number if number is not None and number <= LAST_FRAME else None


def _numbers_in_names(
    files: Files, keys: Mapping[str, Mapping[str, Key]]
) -> dict[str, dict[str, int]] | None:
    """The numbers that names end in; None where these do not tell all frames apart."""
    frames: set[tuple[int | None, Key]] = set()
    found: dict[str, dict[str, int]] = {}
    for camera, paths in files.items():
        mine = {name: _number(name) for name in (same_text(path.name) for path in paths)}
        frames.update((number, keys[camera][name]) for name, number in mine.items())
        found[camera] = {name: number for name, number in mine.items() if number is not None}
        if len(set(found[camera].values())) < len(paths):
            return None
    numbers, names = ({each[place] for each in frames} for place in (0, 1))
    if len(numbers) == len(names) == len(frames):
        return found
    # Names with a time of each camera, and then a number that both count alike.
    sides = [set(some.values()) for some in found.values()]
    return found if 2 * len(set.intersection(*sides)) > max(map(len, sides)) else None


def _given_numbers(
    frames: Sequence[Key], keys: Mapping[str, Mapping[str, Key]], given: Numbers
) -> dict[str, dict[str, int]]:
    """The numbers that were given, and one more for each of the frames that is new.

    A frame keeps the number in its name where no other frame has it. A number that several have is
    none of theirs: labels with it may be of any of them.
    """
    by_key = {
        keys[camera][name]: number
        for camera, some in given.items()
        for name, number in some.items()
        if name in keys.get(camera, {})
    }
    in_names: dict[Key, set[int | None]] = {}
    for some in keys.values():
        for name, key in some.items():
            in_names.setdefault(key, set()).add(_number(name))
    shared = Counter(number for numbers in in_names.values() for number in numbers)
    taken = {number for some in given.values() for number in some.values()}
    for key in frames:
        (number, *others) = in_names[key]
        if key in by_key or number is None or others:
            continue
        if shared[number] == 1 and number not in taken:
            by_key[key] = number
    small = (number for number in taken | set(shared) if number is not None and number < _SMALL)
    free = itertools.count(max(small, default=0) + 1)
    for key in frames:
        if key not in by_key:
            by_key[key] = next(
                number for number in free if number not in taken and number not in shared
            )
    return {
        camera: {name: _kept_number(given.get(camera, {}), name, some, by_key) for name in some}
        for camera, some in keys.items()
    }


def _kept_number(
    given: Mapping[str, int], name: str, names: Mapping[str, Key], by_key: Mapping[Key, int]
) -> int:
    """The number given to a file, or to the one it was converted from; else its frame's."""
    if name in given:
        return given[name]
    stem = Path(name).stem
    gone = (n for old, n in given.items() if old not in names and Path(old).stem == stem)
    return next(gone, by_key[names[name]])


def _read_record(mission: Path) -> dict[str, dict[str, int]]:
    file = mission / RECORD
    try:
        value: Any = json.loads(file.read_bytes())
        check_format(value["format"], FORMAT, f"record of frame numbers {file}")
        found = {str(camera): dict(some) for camera, some in value["numbers"].items()}
        if not all(_are_numbers(some.values()) for some in found.values()):
            raise ValueError(file)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ToktError(f"record of frame numbers {file}: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ToktError(
            f"record of frame numbers {file} is damaged: bring it back from a copy, as labels go"
            " by its numbers"
        ) from None
    return found


def _are_numbers(values: Iterable[Any]) -> bool:
    numbers = list(values)
    whole = all(type(number) is int and 0 <= number <= LAST_FRAME for number in numbers)
    return whole and len(set(numbers)) == len(numbers)


def _keep_record(mission: Path, numbers: Mapping[str, Mapping[str, int]]) -> None:
    text = json.dumps({"format": FORMAT, "numbers": numbers}, indent=1)
    # On a disc or share that cannot be written the same files give the same numbers again.
    with suppress(OSError):
        write_text(mission / RECORD, text + "\n")
