"""Metadata of a mission's frames, out of an iFDO file: time, place, depth, height, heading.

It lies in the mission's folder as ``ifdo.json``, ``.yaml`` or ``.yml``, or beside the mission as
``NAME_ifdo.json``. What the header says holds for all frames that do not say otherwise.

References
----------
https://www.marine-imaging.com/fair/ifdos/iFDO-overview/
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError, naming
from tokt.features.common.extras import needed_by
from tokt.features.frames.mission import Mission

from .images import FrameKey, MissionImages
from .text_file import finite, of_kind, read_json, read_utf8, utc_time

HEADER, ITEMS = "image-set-header", "image-set-items"
YAML = (".yaml", ".yml")
_ENDINGS = (".json", *YAML)
_DEEPEST = 50  # brackets within brackets; iFDO needs ten


@dataclass(frozen=True)
class FrameMetadata:
    """What is known of one frame; None what is not."""

    time: str | None  # UTC, as label records write it
    latitude: float | None  # degrees
    longitude: float | None  # degrees
    depth_m: float | None  # below the surface; negative above it
    above_ground_m: float | None
    heading_deg: float | None  # the camera's yaw: 0 is north, 90 east


def ifdo_of(mission: Path) -> Path | None:
    """The iFDO file that lies in or beside a mission, None where none does."""
    folder = mission.resolve()
    name = folder.name if folder.is_dir() else folder.stem
    paths = [folder / f"ifdo{ending}" for ending in _ENDINGS]
    paths += [folder.with_name(f"{name}_ifdo{ending}") for ending in _ENDINGS]
    return next((path for path in paths if path.is_file()), None)


def mission_metadata(mission: Mission) -> dict[FrameKey, FrameMetadata]:
    """What the file that lies with a mission says, as `read_ifdo`; nothing where none does."""
    path = ifdo_of(mission.path)
    return read_ifdo(path, MissionImages(mission)) if path else {}


def read_ifdo(path: Path, images: MissionImages) -> dict[FrameKey, FrameMetadata]:
    """What an iFDO file says of each of the mission's frames; ToktError if it cannot be read."""
    document = load_ifdo(path)
    found: dict[FrameKey, FrameMetadata] = {}
    for name, item in document[ITEMS].items():
        key = images.find(name).key
        if key is not None:
            with naming(f"{path}: {name!r:.100}"):
                found[key] = _metadata({**document[HEADER], **first_entry(item)})
    return found


def load_ifdo(path: Path) -> dict[str, Any]:
    """An iFDO file, whose header and items are objects and items named by text; as `read_ifdo`."""
    content = _read_yaml(path) if path.suffix.lower() in YAML else read_json(path)
    with naming(path):
        document = of_kind(content, dict, "the file")
        of_kind(document.get(HEADER), dict, HEADER)
        items = of_kind(document.get(ITEMS), dict, ITEMS)
        for name, item in items.items():
            of_kind(name, str, f"{ITEMS}: a name")
            if item in ([], None):  # as BIIGLE writes a picture without annotations
                items[name] = {}
            of_kind(first_entry(items[name]), dict, f"{name!r:.100}")
    return document


def first_entry(item: Any) -> Any:
    """What holds for a file: its item, or the first of a video's, which has one a moment."""
    return item[0] if isinstance(item, list) and item else item


def _metadata(said: Mapping[str, Any]) -> FrameMetadata:
    def number(*names: str) -> float | None:
        name = next((name for name in names if said.get(name) is not None), None)
        return None if name is None else finite(said[name], name)

    altitude = number("image-altitude-meters", "image-altitude")
    depth = number("image-depth")  # before version 2
    return FrameMetadata(
        _time(said.get("image-datetime"), said.get("image-datetime-format")),
        number("image-latitude"),
        number("image-longitude"),
        -altitude if depth is None and altitude is not None else depth,
        number("image-meters-above-ground"),
        number("image-camera-yaw-degrees"),
    )


def _time(value: Any, form: Any) -> str | None:
    text = of_kind(value or "", str, "image-datetime")
    if form is None or not text:
        return utc_time(text)
    try:
        moment = datetime.strptime(text, of_kind(form, str, "image-datetime-format"))
    except ValueError:
        raise ToktError(f"image-datetime {text[:40]!r} is not of the form {form!r:.40}") from None
    return utc_time((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).isoformat())


def _read_yaml(path: Path) -> Any:
    """The value of a YAML file, where times stay text, as in JSON."""
    with needed_by(f"{path}: YAML"):
        import yaml
    loader: Any = type("_Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
    loader.yaml_implicit_resolvers = {
        sign: [entry for entry in found if not entry[0].endswith(":timestamp")]
        for sign, found in loader.yaml_implicit_resolvers.items()
    }
    text, depth = read_utf8(path), 0
    try:
        for event in yaml.parse(text, loader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            # Aliases can fill any memory, and what a tag says need not be so.
            if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None):
                raise ToktError(f"{path}: YAML with an alias (*) or a tag (!), which are not read")
            if depth > _DEEPEST:
                raise ToktError(f"{path}: YAML of more than {_DEEPEST} levels")
        return yaml.load(text, loader)
    except yaml.MarkedYAMLError as error:
        where = f" line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ToktError(f"{path}{where}: not YAML: {error.problem}") from None
    except (yaml.YAMLError, ValueError) as error:  # odd signs, a number of 5,000 digits
        raise ToktError(f"{path}: YAML that cannot be read: {ascii(str(error))[1:100]}") from None
