"""The bundle: the one file that is shipped, and the checks that it must pass to be used.

A bundle ``NAME-VERSION.tokt`` is a zip of these members, stored in this order with no time stamps,
so that the same model gives the same bytes:

- ``manifest.json``: who this model is, how it sees, when it warns (``operating_point``), what its
  training frames show at least (``sight``: `tokt.models.sight`) and which sizes they have
  (``frame_sizes``), where it comes from, and the SHA-256 of the other members;
  ``manifest_sha256`` is the hash of the manifest without that key.
- ``weights.npz``: weights, bias, thresholds (float64); with a map in front of them also its scale,
  offset, limit, landmarks and gamma (`tokt.models.nystroem`).
- ``golden.npz``: frames, as PNG files, with the decision values the training machine computed.
- ``lineage.npz``: the first 8 bytes of the pixel hash of every frame the model learnt from, so
  that nobody scores a model on what it was trained on without being told.
- ``distribution.npz``: how the features of the training patches were distributed, and the limits
  of drift that were measured on them (`tokt.models.distribution`). Not there where a model was
  trained on too little to measure them: its drift is not known.
- ``dataset.zip``: what the model learnt from, as rows of features with classes and dives, so that
  training can go on from it (`tokt.training.fitting.carried`). Models that come with tokt have it.
- ``card.md``: the same for people.

Any format may have one more member, ``signature.json`` (`tokt.models.bundle.signature`). It stands
outside the manifest, whose bytes it signs, and is only carried here: who is trusted, the store
knows.

Reading has three acts that do not mix: *parse* the archive into plain values, *check* every hash,
shape and bound, and only then *construct* and recompute the golden values. No pickle anywhere.

Format 1 has no ``operating_point``: any one patch over its threshold is an obstacle at once.
Formats 1 and 2 have no ``distribution.npz``, formats 1 to 3 no map, and in their operating point
neither a prior of the water nor a distance to landmarks. Formats 1 to 4 have no ``sight``, formats
1 to 5 no ``frame_sizes``: they are those of the golden frames; and no ``dataset.zip``. Formats 1 to
6 have no prior of gray frames.

To change the format: raise FORMAT_VERSION, keep the reader of the old one, and prove with a file
of the old one in a test that it still loads.
"""

import hashlib
import io
import json
import struct
import tokenize
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, U8, U64, Bools
from tokt.features.common.canonical import json_sha256, printable_json
from tokt.features.common.errors import ToktError, check_format, os_errors_as
from tokt.features.common.held_files import file_bytes
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.extractors.spec import build_extractor
from tokt.features.extractors.textures import Extractor
from tokt.features.frames.grid import Grid
from tokt.features.frames.image_file import decode_image
from tokt.features.frames.view_mask import CameraMasks, masks_by_mission
from tokt.features.kernels.quantization import Quantization
from tokt.models.distribution import Distribution
from tokt.models.frame_sizes import Size
from tokt.models.linear import LinearModel, moved
from tokt.models.nystroem import NystroemMap
from tokt.models.operating_point import OBSTACLE, MofNState, OperatingPoint
from tokt.models.sight import (
    NOTHING_SEEN,
    SightLimits,
    blindness,
    joined_sight,
    sight_from_json,
    sight_to_json,
)
from tokt.models.water import WaterState

from .signature import MEMBER as SIGNATURE
from .signature import Signature, signature_from_bytes

FORMAT_VERSION = 7
GOLDEN_TOLERANCE = 1e-9
SUFFIX = ".tokt"
_PNG_START = b"\x89PNG\r\n\x1a\n"

_DISTRIBUTION = "distribution.npz"
_DATASET = "dataset.zip"
_MEMBERS = (
    *("manifest.json", "weights.npz", "golden.npz", "lineage.npz"),
    *(_DISTRIBUTION, _DATASET, "card.md"),
)
_OPTIONAL_SINCE = {_DISTRIBUTION: 3, _DATASET: 6}  # members, and the format that they came with
MAX_MEMBER_BYTES = 64 * 1024 * 1024
_MAX_FAULT = 200  # characters
MAX_NAME = 100
"""Characters of a model's name, and of others in a bundle."""
_MAX_GOLDEN_FRAMES = 100  # training writes two
_MAX_SIZES, _MAX_SIDE = 10_000, 100_000  # of frames; pixels
_MAX_GOLDEN_PIXELS = 100_000_000  # of all together: small files can say they are huge pictures
MAX_FILE_BYTES = len(_MEMBERS) * MAX_MEMBER_BYTES
# What zipfile raises for bytes that are no zip; OverflowError for a member said to be at 2^63.
_UNREADABLE_ZIP = (
    *(zipfile.BadZipFile, struct.error, EOFError, OSError),
    *(RuntimeError, ValueError, OverflowError),
)
# What numpy raises for an array whose header is not one, besides ValueError.
_UNREADABLE_ARRAY = (
    *(ValueError, TypeError, SyntaxError, tokenize.TokenError),
    *(OverflowError, MemoryError, RecursionError, Warning),
)
_MANIFEST_KEYS = {
    *("format_version", "name", "version", "extractor", "grid", "classes"),
    *("provenance", "metrics", "members", "manifest_sha256"),
}
_SINCE = {2: "operating_point", 5: "sight", 6: "frame_sizes"}  # entries of a manifest, by format
_POINT_SINCE_4 = {"water", "unlike"}
_MAP = tuple(each.name for each in fields(NystroemMap))
_DISTRIBUTED = {
    **dict.fromkeys(("edges", "typical", "factor"), np.float64),
    **dict.fromkeys(("counts", "window_frames", "windows", "stretches"), np.int64),
}


@dataclass(frozen=True)
class Golden:
    """Frames and what the training machine computed for them."""

    frames: tuple[bytes, ...]  # PNG files, as the camera gave the frames
    decision_values: F64  # (n_frames, n_patches, n_outputs)
    obstacle: Bools  # (n_frames, n_patches)


@dataclass(frozen=True)
class BundleContent:
    """Everything a bundle holds, before it is written."""

    name: str  # as in the registry, and so the version
    version: str
    extractor_spec: Mapping[str, Any]  # JSON
    grid: Grid
    model: LinearModel
    provenance: Mapping[str, Any]  # MLflow's ids, dataset hash and name, code and library versions
    metrics: Mapping[str, Any]  # cross-validated figures, with how they were split
    golden: Golden
    trained_on: U64  # first 8 bytes of the pixel hash of each training frame
    card: str  # Markdown
    operating_point: OperatingPoint = field(default_factory=OperatingPoint)
    distribution: Distribution | None = None  # None where there is nothing to compare frames with
    sight: tuple[SightLimits, ...] = ()  # for each size of the training frames, where measured
    dataset: bytes | None = None  # as `tokt.training.fitting.carried` has it; opaque here
    frame_sizes: tuple[Size, ...] = ()  # of the training frames; by default the golden frames'

    def __post_init__(self) -> None:
        if not self.frame_sizes:
            sizes = tuple(dict.fromkeys(map(_png_size, self.golden.frames)))
            object.__setattr__(self, "frame_sizes", sizes)


_CONTENT = fields(BundleContent)


@dataclass(frozen=True, kw_only=True)
class Bundle(BundleContent):
    """A bundle that has passed every check: all that it holds, and how it is used.

    Its `signature` has not been checked: that takes a key, which comes from elsewhere.
    """

    extractor: Extractor
    sha256: str
    data: bytes
    signature: Signature | None = None

    def __repr__(self) -> str:
        about = f"{self.extractor.dim} features of a patch, grid {self.grid}"
        return f"{type(self).__name__}({self.label!r}: {about})"

    @property
    def content(self) -> BundleContent:
        """What it holds, such as to write another one from."""
        return BundleContent(**{each.name: getattr(self, each.name) for each in _CONTENT})

    @classmethod
    def load(cls, path: Path | str) -> "Bundle":
        """Read a bundle file and check it whole, as `read_bundle`; ToktError if it fails."""
        return read_bundle(path)

    def with_fixed_boundary(self) -> Self:
        """The same model without a prior of the water; its file and hash stay those it has."""
        return replace(self, operating_point=replace(self.operating_point, water=None))

    def with_sight(self, measured: Sequence[SightLimits]) -> Self:
        """Return the same model for a camera with these limits; its file and hash stay.

        With none it says clear of nothing.
        """
        sight = joined_sight(self.sight, measured) if measured else (NOTHING_SEEN,)
        return replace(self, sight=sight)

    @property
    def label(self) -> str:
        """``name/version``, as datagrams and logs carry it."""
        return f"{self.name}/{self.version}"

    @property
    def masks(self) -> tuple[CameraMasks, ...]:
        """What was no view in the missions that it learnt from, of those that had a mask."""
        return tuple(masks_by_mission(self.content.provenance.get("masks", {})).values())

    @property
    def deployment_fault(self) -> str:
        """Why this model cannot guard a vehicle, or an empty string."""
        if self.grid.width is None:
            return "it was trained on ready-cut patches, not on frames"
        if not any(self.model.obstacle):
            return "none of its classes is an obstacle: it could never warn"
        if all(self.model.obstacle):
            return "each of its classes is an obstacle: it would always warn"
        return self.silence

    @property
    def blindness(self) -> str:
        """Why frames that show nothing may look like open water to it, or an empty string.

        It is empty where one size of its frames has sight: the runtime says it of the others.
        """
        faults = [blindness(self.sight, *size) for size in self.frame_sizes]
        return faults[0] if all(faults) else ""

    @property
    def partly_blind(self) -> str:
        """In frames of which sizes a blurred view may look like open water; empty if in none, or
        in all of them, which `blindness` says.
        """
        blind = [f"{w}x{h}" for h, w in self.frame_sizes if blindness(self.sight, h, w)]
        if not blind or self.blindness:
            return ""
        return (
            f"in frames of {', '.join(blind)} a blurred view may look like open water to model "
            f"{self.label}: its training frames of that size are as smooth. Health says it there"
        )

    def check_sight(self, accept_blind: bool) -> None:
        """Raise ToktError if it may call clear what shows nothing, unless that is accepted."""
        if self.blindness and not accept_blind:
            fault = f"it may call a view clear that shows nothing: {self.blindness}"
            again = "train it again from pictures as the camera gives them, or use --accept-blind"
            raise ToktError(f"model {self.label}: {fault}; {again}")

    @property
    def silence(self) -> str:
        """Why its operating point is never seen to warn, or an empty string.

        A golden frame with obstacle patches, seen again and again, has to come to status 1. Where
        the model sees none in them nothing can be said: a weak one, or one with other obstacle
        classes than it was trained with.
        """
        golden, rule, water = self.golden, self.operating_point.rule, self.operating_point.water
        shown = golden.decision_values[golden.obstacle.any(axis=1)]
        kinds = (False, True) if water and water.gray else (False,)
        if not len(shown) or all(
            any(self._warns(values, gray) for values in shown) for gray in kinds
        ):
            return ""
        return f"it warns of no golden frame with obstacle patches (status 1 with {rule.words()})"

    def _warns(self, values: F64, gray: bool) -> bool:
        """Tell whether a frame with these decision values, seen again and again, has status 1."""
        rule = self.operating_point.rule
        state, water = MofNState(rule), WaterState(self.operating_point.water)
        scores = self.model.obstacle_score(values)
        for _ in range(rule.n):
            water.begin()
            if state.add(scores - water.judge(scores, gray=gray)) == OBSTACLE:
                return True
        return False

    @property
    def images(self) -> tuple[Quantization | None, ...]:
        """The pictures of a frame that the extractor looks at; None is the plain one."""
        return self.extractor.images

    @property
    def needs_colour(self) -> bool:
        """Whether it cannot judge gray frames."""
        return self.extractor.needs_colour

    def decision_values(self, frame: U8) -> F64:
        """Decision values, shape (n_patches, n_outputs), of a frame as `features` takes it."""
        return self.values_of(self.features(frame))

    def features(self, frame: U8, pictures: FramePictures | None = None, threads: int = 1) -> F64:
        """Features of a frame's patches, shape (n_patches, dim).

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
            As the camera gave it, gray or BGR, any size.
        pictures : FramePictures, optional
            The frame's pictures on this grid, where the caller has some already.
        threads : int
            How many threads share the work; the values do not depend on it.
        """
        pictures = pictures or FramePictures(frame, self.grid, threads=threads)
        return self.extractor.describe_pictures(pictures)

    def values_of(self, features: F64) -> F64:
        """Decision values, shape (n_patches, n_outputs), of features of (n_patches, dim)."""
        return self.model.decision_values(features)

    def is_gray(self, features: F64) -> bool:
        """Tell whether a frame with these features has no colour; False where none is looked at."""
        return bool(self.extractor.is_gray(features).all())

    def values_alone(self, features: F64) -> F64:
        """The same of a run's only frame: less the boundary that its own values give."""
        values, water = self.values_of(features), WaterState(self.operating_point.water)
        water.begin()
        scores, gray = self.model.obstacle_score(values), self.is_gray(features)
        boundary = water.judge(scores, gray=gray)
        return moved(values, boundary, self.model.obstacle)


def zip_bytes(members: Mapping[str, bytes]) -> bytes:
    """Return a zip of these members, in this order; the same members give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data)
    return buffer.getvalue()


def npz_bytes(**arrays: NDArray[Any]) -> bytes:
    """Return arrays as an npz file; the same arrays give the same bytes."""
    members: dict[str, bytes] = {}
    for name, array in arrays.items():
        npy = io.BytesIO()
        np.lib.format.write_array(npy, array, allow_pickle=False)
        members[f"{name}.npy"] = npy.getvalue()
    return zip_bytes(members)


def _png_size(png: bytes) -> tuple[int, int]:
    """Height and width from a PNG's header (PNG specification, section 11.2.2)."""
    return int.from_bytes(png[20:24], "big"), int.from_bytes(png[16:20], "big")


def golden_bytes(golden: Golden) -> bytes:
    """The ``golden.npz`` member."""
    return npz_bytes(
        frames=np.frombuffer(b"".join(golden.frames), np.uint8),
        sizes=np.array([len(frame) for frame in golden.frames], np.int64),
        decision_values=golden.decision_values,
        obstacle=golden.obstacle,
    )


def frame_id(digest: str) -> np.uint64:
    """The first 8 bytes of a pixel hash, as `BundleContent.trained_on` holds them."""
    return np.uint64(int(digest[:16], 16))


def weights_bytes(model: LinearModel) -> bytes:
    """The ``weights.npz`` member."""
    mapped = {} if model.map is None else _fields_of(model.map)
    arrays = {"weights": model.weights, "bias": model.bias, "thresholds": model.thresholds}
    return npz_bytes(**arrays, **{name: np.asarray(value) for name, value in mapped.items()})


def distribution_bytes(distribution: Distribution) -> bytes:
    """The ``distribution.npz`` member."""
    values = _fields_of(distribution).items()
    return npz_bytes(**{name: np.asarray(value, _DISTRIBUTED[name]) for name, value in values})


def _fields_of(held: NystroemMap | Distribution) -> dict[str, Any]:
    """Its fields alone, without what it has computed of them since."""
    return {each.name: getattr(held, each.name) for each in fields(held)}


def classes_json(model: LinearModel) -> list[dict[str, Any]]:
    """The classes as a manifest and a model card's recipe have them."""
    pairs = zip(model.classes, model.obstacle, strict=True)
    return [{"name": name, "obstacle": obstacle} for name, obstacle in pairs]


def bundle_bytes(content: BundleContent) -> bytes:
    """The bundle file of a model; the same content gives the same bytes."""
    model = content.model
    members = {
        "weights.npz": weights_bytes(model),
        "golden.npz": golden_bytes(content.golden),
        "lineage.npz": npz_bytes(trained_on=np.sort(content.trained_on)),
        "card.md": content.card.encode("utf-8"),
    }
    if content.distribution is not None:
        members[_DISTRIBUTION] = distribution_bytes(content.distribution)
    if content.dataset is not None:
        members[_DATASET] = content.dataset
    manifest: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "name": content.name,
        "version": content.version,
        "extractor": dict(content.extractor_spec),
        "grid": content.grid.to_json(),
        "classes": classes_json(model),
        "operating_point": content.operating_point.to_json(),
        "sight": sight_to_json(content.sight),
        "frame_sizes": [list(size) for size in content.frame_sizes],
        "provenance": dict(content.provenance),
        "metrics": dict(content.metrics),
        "members": {name: hashlib.sha256(data).hexdigest() for name, data in members.items()},
    }
    manifest["manifest_sha256"] = json_sha256(manifest)
    members["manifest.json"] = (json.dumps(manifest, indent=2, sort_keys=True) + "\n").encode()
    return zip_bytes({name: members[name] for name in _MEMBERS if name in members})


def unzip(data: bytes, where: str) -> dict[str, bytes]:
    """A zip's members; ToktError if it is none, or one is packed, encrypted, repeated or huge."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
            if any(
                info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1 for info in infos
            ):
                raise ToktError(f"{where}: damaged, or not written by tokt (it is compressed)")
            if any(info.file_size > MAX_MEMBER_BYTES for info in infos):
                raise ToktError(f"{where}: a member of the bundle is too large")
            if len({info.filename for info in infos}) != len(infos):
                raise ToktError(f"{where}: a member is in it twice")
            # Members inside one another would be read into far more memory than the file takes.
            if sum(info.file_size for info in infos) > len(data):
                raise ToktError(f"{where}: the members are larger than the file")
            return {info.filename: archive.read(info) for info in infos}
    except _UNREADABLE_ZIP as error:
        raise ToktError(f"{where}: truncated or damaged ({error})") from None


def signed_parts(data: bytes, where: str) -> tuple[bytes, Signature | None]:
    """The raw manifest of a bundle file and its signature, if any; nothing else is looked at.

    Raises ToktError if the file is not a zip with a manifest, or the signature cannot be read.
    """
    members = unzip(data, where)
    return _manifest_of(members, where), _signature_of(members, where)


def with_signature(data: bytes, signature: Signature, where: str) -> bytes:
    """The same bundle file with this signature in place of any it had."""
    members = unzip(data, where)
    members[SIGNATURE] = signature.to_bytes()
    return zip_bytes(members)


def _manifest_of(members: dict[str, bytes], where: str) -> bytes:
    """Take the raw manifest out of the members."""
    if "manifest.json" not in members:
        raise ToktError(f"{where}: not a tokt bundle (no manifest.json in it)")
    return members.pop("manifest.json")


def _signature_of(members: dict[str, bytes], where: str) -> Signature | None:
    """Take the signature, if there is one, out of the members."""
    member = members.pop(SIGNATURE, None)
    return None if member is None else signature_from_bytes(member, where)


def _parse(data: bytes, where: str) -> tuple[dict[str, Any], Signature | None, dict[str, bytes]]:
    """Act one: the archive as a manifest and raw members; nothing is believed yet."""
    members = unzip(data, where)
    try:
        manifest = printable_json(_manifest_of(members, where))
    except (ValueError, RecursionError):
        raise ToktError(f"{where}: the bundle's manifest is not JSON") from None
    if not isinstance(manifest, dict):
        raise ToktError(f"{where}: not a tokt bundle (no manifest in it)")
    return manifest, _signature_of(members, where), members


def _check_integrity(manifest: dict[str, Any], members: dict[str, bytes], where: str) -> None:
    """Act two, first half: the format is known, nothing is missing, added or edited."""
    version = manifest.get("format_version", 0)
    try:
        check_format(version, FORMAT_VERSION, f"{where}: the bundle")
    except ValueError:
        raise ToktError(f"{where}: the bundle has no format version") from None
    newer = {entry for since, entry in _SINCE.items() if version >= since}
    if set(manifest) != _MANIFEST_KEYS | newer:
        raise ToktError(f"{where}: the bundle's manifest has unknown or missing entries")
    bare = {key: value for key, value in manifest.items() if key != "manifest_sha256"}
    try:
        sound = json_sha256(bare) == manifest["manifest_sha256"]
    except (ValueError, RecursionError):
        sound = False
    if not sound:
        raise ToktError(f"{where}: the bundle's manifest has been edited (its hash does not match)")
    missing = {
        name for name, since in _OPTIONAL_SINCE.items() if version < since or name not in members
    }
    wanted = set(_MEMBERS[1:]) - missing
    if not isinstance(manifest["members"], dict) or not (
        set(manifest["members"]) == set(members) == wanted
    ):
        raise ToktError(f"{where}: the bundle has unknown or missing members")
    for name, data in members.items():
        if hashlib.sha256(data).hexdigest() != manifest["members"][name]:
            raise ToktError(f"{where}: {name} in the bundle has been edited (hash does not match)")


def _arrays(data: bytes, wanted: Mapping[str, type], where: str, member: str) -> dict[str, Any]:
    """An npz member's arrays, of just the names and dtypes expected."""
    return arrays_of(unzip(data, f"{where}: {member}"), wanted, f"{where}: {member}")


def arrays_of(
    members: Mapping[str, bytes], wanted: Mapping[str, type], where: str
) -> dict[str, Any]:
    """The arrays in npy files, by name; ToktError if names and dtypes are not just these."""
    try:
        # numpy warns of headers as Python 2 wrote them, and of shapes beyond any number.
        with warnings.catch_warnings(action="error", category=Warning):
            arrays = {
                name.removesuffix(".npy"): np.lib.format.read_array(
                    io.BytesIO(npy), allow_pickle=False
                )
                for name, npy in members.items()
            }
    except _UNREADABLE_ARRAY as error:
        raise ToktError(f"{where} cannot be read ({error})") from None
    if {name: array.dtype for name, array in arrays.items()} != wanted:
        raise ToktError(f"{where} does not hold {', '.join(wanted)} as expected")
    return arrays


def weights_from_bytes(data: bytes, where: str) -> dict[str, Any]:
    """Read a ``weights.npz`` member: arrays and map of a `LinearModel`, or raise ToktError."""
    where = f"{where}: weights.npz"
    members = unzip(data, where)
    has_map = "landmarks.npy" in members
    names = ("weights", "bias", "thresholds", *(_MAP if has_map else ()))
    arrays = arrays_of(members, dict.fromkeys(names, np.float64), where)
    if not has_map:
        return arrays
    mapped = {name: arrays.pop(name) for name in _MAP}
    try:
        numbers = {name: mapped[name].item() for name in ("limit", "gamma")}
        return {**arrays, "map": NystroemMap(**{**mapped, **numbers})}
    except (TypeError, ValueError) as error:
        raise ToktError(f"{where} does not fit together ({_brief(error)})") from None


def lineage_from_bytes(data: bytes, where: str) -> U64:
    """Read a ``lineage.npz`` member. Raises ToktError if it is none."""
    trained_on = _arrays(data, {"trained_on": np.uint64}, where, "lineage.npz")["trained_on"]
    if trained_on.ndim != 1:
        raise ToktError(f"{where}: lineage.npz is not a list of frames")
    return np.asarray(trained_on)


def distribution_from_bytes(data: bytes, where: str) -> Distribution:
    """Read a ``distribution.npz`` member. Raises ToktError if it is none."""
    arrays = _arrays(data, _DISTRIBUTED, where, _DISTRIBUTION)
    numbers = ("factor", "window_frames", "windows", "stretches")
    try:
        if any(arrays[name].ndim for name in numbers):
            raise ValueError("a number is an array")
        return Distribution(**{**arrays, **{name: arrays[name].item() for name in numbers}})
    except (TypeError, ValueError) as error:
        fault = _brief(error)
        raise ToktError(f"{where}: {_DISTRIBUTION} does not fit together ({fault})") from None


def golden_from_bytes(data: bytes, where: str) -> Golden:
    """Read a ``golden.npz`` member. Raises ToktError if it is none."""
    wanted = {
        "frames": np.uint8,
        "sizes": np.int64,
        "decision_values": np.float64,
        "obstacle": np.bool_,
    }
    arrays = _arrays(data, wanted, where, "golden.npz")
    sizes, values, obstacle = arrays["sizes"], arrays["decision_values"], arrays["obstacle"]
    if sizes.ndim != 1 or not len(sizes) or (sizes < 1).any():
        raise ToktError(f"{where}: the bundle has no golden frames")
    if sizes.sum() != arrays["frames"].size or values.ndim != 3 or len(values) != len(sizes):
        raise ToktError(f"{where}: the bundle's golden frames and values do not fit together")
    if obstacle.shape != values.shape[:2]:
        raise ToktError(f"{where}: the bundle's golden verdicts and values do not fit together")
    raw = io.BytesIO(arrays["frames"].tobytes())
    frames = tuple(map(raw.read, sizes.tolist()))
    if not all(frame.startswith(_PNG_START) for frame in frames):
        raise ToktError(f"{where}: the bundle's golden frames are not PNG files")
    pixels = sum(height * width for height, width in map(_png_size, frames))
    if len(frames) > _MAX_GOLDEN_FRAMES or pixels > _MAX_GOLDEN_PIXELS:
        many = f"{len(frames)} golden frames of {pixels} pixels"
        raise ToktError(f"{where}: {many} are more than a bundle needs")
    return Golden(frames, values, obstacle)


def _brief(error: Exception) -> str:
    """What is wrong on one line of a readable length, whatever the file holds."""
    text = " ".join(str(error).split())
    return text if len(text) <= _MAX_FAULT else f"{text[:_MAX_FAULT]}..."


def _text(value: Any) -> str:
    """A name: it goes into every datagram, log line and history, so it is short and one line."""
    if not isinstance(value, str) or not 0 < len(value) <= MAX_NAME:
        raise TypeError(f"{value!r} is not a name of 1 to {MAX_NAME} characters")
    if not value.isprintable():
        raise TypeError(f"{value!r} is not a name: it has unprintable characters")
    return value


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError(f"{value!r} is not an object")
    return value


def _classes_from(value: Any) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Names and obstacle flags; a flag that is not a plain yes or no is not taken for a no."""
    if any(
        set(item) != {"name", "obstacle"} or type(item["obstacle"]) is not bool for item in value
    ):
        raise TypeError("a class is a name and an obstacle flag")
    return tuple(_text(item["name"]) for item in value), tuple(item["obstacle"] for item in value)


def _sizes_from(value: Any) -> tuple[Size, ...]:
    """Heights and widths of the training frames."""
    if not isinstance(value, list) or not 0 < len(value) <= _MAX_SIZES:
        raise TypeError(f"frame_sizes is not a list of 1 to {_MAX_SIZES} sizes")
    for size in value:
        sound = isinstance(size, list) and len(size) == 2
        if not sound or any(type(side) is not int or not 0 < side <= _MAX_SIDE for side in size):
            raise TypeError(f"{size!r} is not the height and width of a frame")
    return tuple((height, width) for height, width in value)


def _operating_point(manifest: Mapping[str, Any], grid: Grid, model: LinearModel) -> OperatingPoint:
    """The manifest's; a rule that no frame could meet is refused."""
    if "operating_point" not in manifest:
        return OperatingPoint()
    point = OperatingPoint.from_json(manifest["operating_point"])
    newer = _POINT_SINCE_4.intersection(manifest["operating_point"])
    if newer and manifest["format_version"] < 4:
        raise ToktError(f"its format knows no {min(newer)} in an operating point")
    if point.water is not None:
        rounds = "rounds" in manifest["operating_point"]["water"]
        if rounds != (manifest["format_version"] >= 6):
            raise ToktError("a prior of the water says its rounds from format 6 on")
        gray = "gray" in manifest["operating_point"]["water"]
        if gray != (manifest["format_version"] >= 7):
            raise ToktError("a prior of the water says that of gray frames from format 7 on")
    if point.unlike is not None and model.map is None:
        raise ToktError("a distance to landmarks, and no landmarks")
    if point.water is not None and len(set(model.obstacle)) < 2:
        raise ToktError("a prior of water and obstacles, and classes of one side")
    if point.rule.min_patches > grid.n_patches:
        asked = f"{point.rule.min_patches} of {grid.n_patches} patches"
        raise ToktError(f"its frame rule asks for {asked}")
    return point


def _check_content(
    manifest: dict[str, Any], members: dict[str, bytes], where: str
) -> BundleContent:
    """Act two, second half: every value has the shape and the bounds it must have."""
    arrays = weights_from_bytes(members["weights.npz"], where)
    if "map" in arrays and manifest["format_version"] < 4:
        raise ToktError(f"{where}: its format knows no map before the weights")
    trained_on = lineage_from_bytes(members["lineage.npz"], where)
    golden = golden_from_bytes(members["golden.npz"], where)
    distribution = None
    if _DISTRIBUTION in members:
        distribution = distribution_from_bytes(members[_DISTRIBUTION], where)
    try:
        names, obstacle = _classes_from(manifest["classes"])
        grid, metrics = Grid.from_json(manifest["grid"]), _object(manifest["metrics"])
        _object(metrics.get("patch", {}))  # cards and changed flags take that for granted
        model = LinearModel(**arrays, classes=names, obstacle=obstacle)
        return BundleContent(
            name=_text(manifest["name"]),
            version=_text(manifest["version"]),
            extractor_spec=_object(manifest["extractor"]),
            grid=grid,
            model=model,
            provenance=_object(manifest["provenance"]),
            metrics=metrics,
            golden=golden,
            trained_on=trained_on,
            card=members["card.md"].decode("utf-8"),
            operating_point=_operating_point(manifest, grid, model),
            distribution=distribution,
            dataset=members.get(_DATASET),
            sight=sight_from_json(manifest["sight"]) if "sight" in manifest else (),
            frame_sizes=_sizes_from(manifest["frame_sizes"]) if "frame_sizes" in manifest else (),
        )
    except (ToktError, TypeError, ValueError) as error:
        fault = _brief(error)
        raise ToktError(f"{where}: the bundle's content does not fit together ({fault})") from None


def _check_golden(bundle: Bundle, where: str) -> None:
    """Act three: this machine must compute what the training machine computed."""
    golden = bundle.golden
    shape = (bundle.grid.n_patches, len(bundle.model.bias))
    if golden.decision_values.shape[1:] != shape:
        raise ToktError(f"{where}: the golden values have another shape than the model's grid")
    for index, png in enumerate(golden.frames):
        frame = decode_image(png, f"{where}: golden frame {index}")
        try:
            values = bundle.decision_values(frame)
        except (ToktError, ValueError) as error:
            raise ToktError(f"{where}: golden frame {index} cannot be judged ({error})") from None
        expected = golden.decision_values[index]
        difference = float(np.abs(values - expected).max())
        # Unscaled features give decision values in the thousands, whose last bits are worth more.
        tolerance = GOLDEN_TOLERANCE * max(1.0, float(np.abs(values).max()))
        if not difference <= tolerance:
            raise ToktError(
                f"{where}: golden frame {index} gives decision values that differ by "
                f"{difference:.3g} from the training machine's (limit {tolerance:g}). "
                "The model would not judge here as it was trained to"
            )
        if (bundle.model.obstacle_patches(values) != golden.obstacle[index]).any():
            raise ToktError(f"{where}: golden frame {index} gives other obstacle patches")


def bundle_from_bytes(data: bytes, where: str, *, golden: bool = True) -> Bundle:
    """Parse, check and construct a bundle, then recompute its golden values.

    `where` is what to call it in an error, usually its path. Without `golden` the last step is left
    out, and nothing else. That is only for bytes whose SHA-256 another process of this tokt on this
    machine has just checked whole: the runtime has a new model checked beside itself
    (`tokt.models.store.check_active`), so that no frame waits for it.

    Raises ToktError if any step fails; nothing of a refused bundle is kept.
    """
    manifest, signature, members = _parse(data, where)
    _check_integrity(manifest, members, where)
    content = _check_content(manifest, members, where)
    try:
        extractor = build_extractor(content.extractor_spec)
    except ToktError as error:
        raise ToktError(f"{where}: {_brief(error)}") from None
    takes = f"{where}: the model takes {content.model.dim} features"
    if extractor.dim != content.model.dim:
        raise ToktError(f"{takes}, its extractor gives {extractor.dim}")
    if content.distribution is not None and content.distribution.dim != content.model.dim:
        raise ToktError(f"{takes}, its distribution has {content.distribution.dim}")
    bundle = Bundle(
        **vars(content),
        extractor=extractor,
        sha256=hashlib.sha256(data).hexdigest(),
        data=data,
        signature=signature,
    )
    if golden:
        _check_golden(bundle, where)
    return bundle


def bundle_file_bytes(path: Path | str) -> bytes:
    """The bytes of a bundle file. Raises ToktError if it is not there or far too large for one."""
    with os_errors_as(f"bundle {path}"):
        data = file_bytes(path, at_most=MAX_FILE_BYTES + 1)
    if len(data) > MAX_FILE_BYTES:
        raise ToktError(f"bundle {path}: far too large for a bundle")
    return data


def read_bundle(path: Path | str) -> Bundle:
    """Read a bundle file and check it whole, as `bundle_from_bytes`; ToktError if it fails."""
    return bundle_from_bytes(bundle_file_bytes(path), str(path))
