"""The space of a search: which extractors, C and class weights are tried, simple ones first.

A TOML file::

    format = 1
    penalties = [0.01, 0.1, 1.0]            # LinearSVC's C
    class_weights = ["none", "balanced"]
    changes = ["gain_0.5", "jpeg_60"]       # may be left out: learn from frames so changed, too,
    change_weight = 0.05                    # each counting so much
    landmarks = 600                         # may be left out: Nystroem's map before the LinearSVC,
    gamma = 0.3                             # and its gamma, times the number of features

    [extractors]                            # a name of your own = the extractor
    coarse = "lbp_24_8+haralick"            # names as in `tokt train --extractor`
    mine = "spec:mine.json"                 # a spec in a file, beside this one
    fine = { name = "lbp", version = 1, points = 8, radius = 1, border = "frame", image = {...} }

Each extractor is one trial; its C and class weight are chosen inside each training part.
"""

import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tokt.features.common.canonical import canonical_json, json_sha256
from tokt.features.common.errors import ToktError, naming
from tokt.features.extractors.extractor import Extractor, build_extractor, extractor_named
from tokt.training.datasets.augmentations import parse_augmentation
from tokt.training.fitting.presets import TrainingSettings

SPACE_FORMAT = 1
PRESET = "search"
BUILT_IN = Path(__file__).with_name("space.toml")
_OPTIONAL = {"changes", "change_weight", "landmarks", "gamma"}
_MAX_LANDMARKS = 10_000
_KEYS = {"format", "penalties", "class_weights", "extractors"}
_WEIGHTS = {"none": None, "balanced": "balanced"}
_FILE = "spec:"


@dataclass(frozen=True)
class Trial:
    """One extractor to be tried."""

    name: str  # its name in the space file
    spec: dict[str, Any] = field(hash=False)
    features: int  # columns of a patch's row
    pictures: int  # different pictures of a frame it looks at: each costs time at run time

    @property
    def id(self) -> str:
        """A short hash of the spec."""
        return json_sha256(self.spec)[:12]

    @property
    def cost(self) -> tuple[int, int, str]:
        """Order of trials from simple to rich; no measured time, which is never twice the same.

        Number of features, then of pictures, then the name.
        """
        return self.features, self.pictures, self.name


@dataclass(frozen=True)
class Space:
    """The trials of a search and their common settings."""

    trials: tuple[Trial, ...]  # simple ones first
    settings: TrainingSettings  # the candidates for C and class weight, the augmentations, the seed


def read_space(path: Path = BUILT_IN) -> Space:
    """Read a space file; ToktError if anything in it is unknown, missing or given twice."""
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ToktError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, 1,000 brackets
        raise ToktError(f"{path}: not a TOML file ({error})") from None
    with naming(path):
        return _space_from(content, path.parent)


def _space_from(content: dict[str, Any], folder: Path) -> Space:
    if content.get("format") != SPACE_FORMAT:
        raise ToktError(f"a space file says 'format = {SPACE_FORMAT}', not {content.get('format')}")
    wrong = (set(content) - _OPTIONAL) ^ _KEYS
    if wrong:
        raise ToktError(f"unknown or missing: {', '.join(sorted(wrong))}")
    extractors = content["extractors"]
    if not isinstance(extractors, dict) or not extractors:
        raise ToktError("[extractors] holds at least one NAME = extractor")
    built = {name: _named(name, value, folder) for name, value in extractors.items()}
    found = (
        Trial(name, extractor.spec, extractor.dim, len(_pictures(extractor.spec)))
        for name, extractor in built.items()
    )
    trials = sorted(found, key=lambda trial: trial.cost)
    named: dict[str, str] = {}
    for trial in trials:
        if trial.id in named:
            raise ToktError(f"extractors {named[trial.id]} and {trial.name} are the same")
        named[trial.id] = trial.name
    landmarks = content.get("landmarks", 0)
    if type(landmarks) is not int or not 0 <= landmarks <= _MAX_LANDMARKS:
        raise ToktError(f"landmarks: a whole number, 0 to {_MAX_LANDMARKS}, not {landmarks!r}")
    settings = TrainingSettings(
        PRESET,
        scale=True,
        penalties=_penalties(content["penalties"]),
        two_images=False,
        class_weights=_class_weights(content["class_weights"]),
        changes=_changes(content.get("changes", [])),
        change_weight=_positive("change_weight", content.get("change_weight", 1.0)),
        landmarks=landmarks,
        gamma=_positive("gamma", content.get("gamma", 0.3)),
    )
    return Space(tuple(trials), settings)


def _positive(name: str, value: Any) -> float:
    if type(value) not in (int, float) or not 0 < value <= sys.float_info.max:
        raise ToktError(f"{name}: a number above 0, not {value!r}")
    return float(value)


def _penalties(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise ToktError("penalties is a list of numbers")
    return tuple(sorted({_positive("penalties", number) for number in value}))


def _class_weights(value: Any) -> tuple[str | None, ...]:
    names = value if isinstance(value, list) else []
    if not names or not all(isinstance(name, str) and name in _WEIGHTS for name in names):
        raise ToktError(f"class_weights is a list of {' and '.join(map(repr, _WEIGHTS))}")
    return tuple(_WEIGHTS[name] for name in _WEIGHTS if name in names)


def _changes(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise ToktError("changes is a list of names, as gain_0.5")
    for name in value:
        parse_augmentation(name)
    return tuple(dict.fromkeys(value))


def _named(name: str, value: Any, folder: Path) -> Extractor:
    with naming(f"extractor {name}"):
        if isinstance(value, str) and value.startswith(_FILE):
            return extractor_named(_FILE + str(folder / value.removeprefix(_FILE)))
        return extractor_named(value) if isinstance(value, str) else build_extractor(value)


def _pictures(spec: Any) -> set[str]:
    """Every ``image`` inside a spec, as text."""
    if isinstance(spec, list):
        return set().union(*map(_pictures, spec))
    if not isinstance(spec, dict):
        return set()
    own = {canonical_json(spec["image"])} if "image" in spec else set()
    return own.union(*(_pictures(value) for key, value in spec.items() if key != "image"))
