"""Dataset versions: immutable snapshots of patches, labels, taxonomy and grid, named by content.

On disk, below the workspace::

    datasets/NAME/HASH/dataset.json     format, task, grid, taxonomy, counts, sources
    datasets/NAME/HASH/patches.parquet  one row a labelled patch
    datasets/NAME/HASH/frames.parquet   one row a frame: mission, camera, number, position in the
                                        dive, file name, group, pixel hash
    datasets/NAME/HASH/frames/          the frames' own files, named by pixel hash; of frames that
                                        must not be given away files of rows (`frame_rows`)
    datasets/NAME/latest                the hash that NAME alone means

The hash is SHA-256 over everything that can change what a model learns: task, grid, taxonomy,
every patch's label and group, every frame's pixels. It does not cover the dataset's name, nor
how a frame's file is compressed, nor the missions' `sites`, which are only there where some were
given: they say how to test, not what is learnt. The same goes for `single_pictures`, the missions
whose frames are no sequence, each with how that is known. It covers the names of files of rows, and
so their content. `unsure` patches are counted, never stored. The missions' `masks`, where there are
any, are covered by the hash: frames are stored as the camera gave them, and read with what is no
view covered.

To change the format: raise FORMAT_VERSION, keep reading the old ones, prove it with a test.

1. Frames' numbers alone: blocks and gaps count by them.
2. Each frame's position in its dive, and its file's name.
"""

import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common import atomic
from tokt.features.common.arrays import I64, U8, Bools
from tokt.features.common.canonical import canonical_json
from tokt.features.common.errors import FrameError, ToktError, check_format, naming, os_errors_as
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.frames.grid import Grid
from tokt.features.frames.image_file import decode_image, pixel_sha256
from tokt.features.frames.view_mask import CameraMasks, ViewMask, masks_by_mission
from tokt.inference.sight import FLAT, SightMeter, causes_on_grid
from tokt.labels.taxonomy import Taxonomy
from tokt.models.sight import SightLimits

from .dataset_sight import measured_sight, unseen_frames
from .folds import BLOCK_FRAMES, block_of, joined_names
from .frame_rows import SUFFIX as ROWS
from .frame_rows import file_name

FORMAT_VERSION = 2
BINARY = "binary"
TASKS = (BINARY, "classes")
CLEAR, OBSTACLE = "clear", "obstacle"
_NAME = re.compile(r"[\w-][\w.-]*")
HASH_CHARS = 16
"""Of a dataset's hash, in the name of its folder."""
_HASHED_AT_ONCE = 1 << 18  # rows
_VERSION_INFO = "[0-9a-f]" * HASH_CHARS + "/dataset.json"  # never of a half-written folder
FRAME_KEY = ["mission", "camera", "frame"]
PATCH_KEY = [*FRAME_KEY, "row", "col"]
DIVE_ORDER = ["mission", "camera", "position", "frame"]
"""What tables are sorted by. A dive's frames come in the order of their positions."""
PATCH_COLUMNS = [*PATCH_KEY, "label", "group"]
_HASHED_FRAME_COLUMNS = [*FRAME_KEY, "group", "digest"]
_FRAME_COLUMNS = [*_HASHED_FRAME_COLUMNS, "file", "height", "width"]
_PLACED = ["position", "name"]  # columns of frames since format 2
_HASHED_INFO = ("format_version", "task", "grid", "taxonomy", "block_frames")


@dataclass(frozen=True)
class FrameSource:
    """One frame to take into a dataset."""

    mission: str
    camera: str
    frame: int
    group: str  # frames of one group are never split between training and test
    load: Callable[[], tuple[bytes, str]]  # gives the frame's encoded file and suffix; called once
    # Pixel hash, height and width of the frame, where that file is one of rows.
    known: tuple[str, int, int] | None = None
    # Its place in the dive, counted in frames: what blocks and gaps go by. None: its number.
    position: int | None = None
    name: str = ""  # its file's; empty where it had none of its own


@dataclass(frozen=True)
class DatasetPlan:
    """The content of a dataset that is to be built."""

    name: str
    task: str  # of `TASKS`
    grid: Grid
    taxonomy: Taxonomy
    frames: Sequence[FrameSource]
    patches: pd.DataFrame  # columns mission, camera, frame, row, col, label; no `unsure` in it
    unsure: int  # how many patches were left out as `unsure`
    # Frames a group, which follow each other; None where nothing says which patches belong together
    # (a folder of patches): figures from such a dataset are marked ungrouped.
    block_frames: int | None
    sources: list[str]  # for people: what was read; not part of the hash
    sites: dict[str, str] = field(default_factory=dict)  # by mission, if known; not of the hash
    masks: dict[str, CameraMasks] = field(default_factory=dict)  # by mission, where it has any
    # Missions whose frames are no sequence, each with how that is known.
    single_pictures: dict[str, str] = field(default_factory=dict)
    # Frames for which the scene stays the same, by mission, where that could be measured.
    scene_frames: dict[str, int] = field(default_factory=dict)


class DatasetVersion:
    """A dataset on disk. Opening one reads its tables; frames are read when asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.info: dict[str, Any] = json.loads((path / "dataset.json").read_text("utf-8"))
            check_format(self.info["format_version"], FORMAT_VERSION, f"dataset {path}")
            self.name = str(self.info["name"])
            self.hash = str(self.info["hash"])
            self.task = str(self.info["task"])
            self.block_frames: int | None = self.info["block_frames"]
            self.grid = Grid.from_json(self.info["grid"])
            # The site of each mission whose site was given; empty in older datasets.
            self.sites: dict[str, str] = self.info.get("sites", {})
            # Missions whose frames are no sequence; empty in older datasets.
            self.single_pictures = tuple(sorted(self.info.get("single_pictures", {})))
            if not isinstance(self.sites, dict):
                raise TypeError
        except (OSError, ValueError, KeyError, TypeError):
            raise ToktError(f"dataset {path} is damaged or not a dataset") from None
        self.taxonomy = Taxonomy.from_json(self.info.get("taxonomy"), f"dataset {path}")

    def __repr__(self) -> str:
        counts = f"{self.info['patches']} patches in {self.info['frames']} frames"
        return f"{type(self).__name__}({self.label!r}: {counts})"

    @property
    def label(self) -> str:
        """``name@hash``."""
        return f"{self.name}@{self.hash[:HASH_CHARS]}"

    @property
    def has_positions(self) -> bool:
        """True unless it is of an older tokt, whose blocks go by the numbers of frames."""
        return bool(self.info["format_version"] > 1)

    def independent_block(self, mission: str, position: int) -> str:
        """The block of a frame, no shorter than the scene stays the same, or `BLOCK_FRAMES`."""
        scene = self.info.get("scene_frames", {}).get(mission, 0)
        return block_of(mission, position, max(BLOCK_FRAMES, scene))

    @cached_property
    def frames(self) -> pd.DataFrame:
        """One row a frame, in the order of `DIVE_ORDER`.

        Columns mission, camera, frame, group, digest, file, height, width, position, name.
        """
        if self.has_positions:
            return self._table("frames.parquet", [*_FRAME_COLUMNS, *_PLACED])
        old = self._table("frames.parquet", _FRAME_COLUMNS)
        return old.assign(position=old.frame, name="")

    @cached_property
    def patches(self) -> pd.DataFrame:
        """One row a labelled patch, in the order of `DIVE_ORDER`, row and col.

        Columns mission, camera, frame, row, col, label, group, position.
        """
        if self.has_positions:
            return self._table("patches.parquet", [*PATCH_COLUMNS, "position"])
        old = self._table("patches.parquet", PATCH_COLUMNS)
        return old.assign(position=old.frame)

    def _table(self, name: str, columns: list[str]) -> pd.DataFrame:
        try:
            return pd.read_parquet(self.path / name, columns=columns)
        except (OSError, ValueError):
            raise ToktError(f"dataset {self.label}: {name} is missing or damaged") from None

    def check(self) -> None:
        """Raise ToktError unless the tables are those that the dataset's hash was taken of.

        Frames are checked one by one, as `read_frame` reads them.
        """
        if _content_hash(self.info, self.patches, self.frames) != self.hash:
            raise ToktError(f"dataset {self.label} has been changed on disk; build it again")

    @cached_property
    def masks(self) -> dict[str, CameraMasks]:
        """What is no view in the missions' pictures, for those that have a mask."""
        return masks_by_mission(self.info.get("masks", {}))

    def mask(self, index: int) -> ViewMask | None:
        """What is no view of the frame in row `index` of `frames`."""
        if not self.masks:
            return None
        row = self.frames.iloc[index]
        return self.masks[row.mission].of(row.camera) if row.mission in self.masks else None

    def patches_in_view(self, index: int) -> int:
        """Number of patches that are not masked of the frame in row `index` of `frames`."""
        mask = self.mask(index)
        if mask is None:
            return self.grid.n_patches
        row = self.frames.iloc[index]
        size = self.grid.resized(int(row.height), int(row.width))
        return int((~mask.patches(self.grid, *size)).sum())

    def read_frame(self, index: int) -> U8:
        """The frame in row `index` of `frames`, checked against its pixel hash, its mask covered.

        Raises ToktError if the stored frame is not the one the dataset was built from, or the
        dataset has no picture of it.
        """
        row, mask = self.frames.iloc[index], self.mask(index)
        if not self.pictured[index]:
            raise ToktError(
                f"dataset {self.label} has features of frame {row.frame} of {row.mission}, and no "
                "picture of it"
            )
        return read_stored_frame(self.path / "frames" / row.file, row.digest, mask)

    @cached_property
    def pictured(self) -> Bools:
        """Of each row of `frames` whether there is a picture, and not features alone."""
        return np.array([not file.endswith(ROWS) for file in self.frames.file], bool)

    @property
    def is_gray(self) -> bool:
        """Whether the first picture of a mission's camera has no colour."""
        pictured = self.frames[self.pictured].reset_index()
        first = pictured.groupby(["mission", "camera"])["index"].first()
        return not all(
            FramePictures(self.read_frame(int(index)), self.grid).has_colour for index in first
        )

    @cached_property
    def sight(self) -> tuple[SightLimits, ...]:
        """What its frames show at least; models of one dataset share it."""
        if self.grid.width is None:  # ready-cut patches
            return ()
        return measured_sight(self.frames[self.pictured], self.read_frame, self.mask)

    @cached_property
    def unseen(self) -> dict[str, list[int]]:
        """Rows of `frames` that a run would not call clear, by the code of the reason."""
        if self.grid.width is None:
            return {}
        return unseen_frames(self.sight, self.frames[self.pictured], self.read_frame, self.mask)

    def classes(self) -> tuple[str, ...]:
        """The classes that a model of this dataset tells apart, in the model's order."""
        if self.task == "binary":
            return CLEAR, OBSTACLE
        present = set(self.patches.label)
        names = [name for name in self.taxonomy.names if name in present]
        if len(names) == 2:
            names.sort(key=self.taxonomy.is_obstacle)
        return tuple(names)

    def targets(self) -> I64:
        """Index into `classes` for each patch."""
        labels = self.patches.label
        if self.task == "binary":
            flags = {name: self.taxonomy.is_obstacle(name) for name in labels.unique()}
            return np.asarray(labels.map(flags), np.int64)
        order = {name: index for index, name in enumerate(self.classes())}
        return np.asarray(labels.map(order), np.int64)

    def obstacle_flags(self) -> tuple[bool, ...]:
        """For each of `classes` whether it is an obstacle."""
        if self.task == "binary":
            return False, True
        return tuple(self.taxonomy.is_obstacle(name) for name in self.classes())

    def obstacles(self) -> Bools:
        """For each patch whether it is labelled as one."""
        return np.asarray(self.obstacle_flags(), bool)[self.targets()]


def read_stored_frame(path: Path, digest: str, mask: ViewMask | None = None) -> U8:
    """A dataset's frame file, its mask covered.

    Raises ToktError where it is not the frame that the dataset was built from.
    """
    with os_errors_as(f"dataset frame {path}"):
        image = decode_image(path.read_bytes(), str(path))
    if pixel_sha256(image) != digest:
        raise ToktError(f"dataset frame {path} has changed since the dataset was built")
    return image if mask is None else mask.cover(image)


def _check_classes(plan: DatasetPlan) -> None:
    labels = sorted(plan.patches.label.unique())
    if not labels:
        raise ToktError(f"dataset {plan.name}: no labelled patch to learn from")
    if plan.task == "classes" and len(labels) < 2:
        raise ToktError(f"dataset {plan.name} has one class only ({labels[0]})")
    sides = {plan.taxonomy.is_obstacle(label) for label in labels}
    if sides == {False} and plan.task == "classes":
        raise ToktError(
            f"dataset {plan.name}: none of its classes ({', '.join(labels)}) is an obstacle; a "
            "model of it could never warn"
        )
    if plan.task == "binary" and len(sides) < 2:
        side, other = (OBSTACLE, CLEAR) if sides.pop() else (CLEAR, OBSTACLE)
        raise ToktError(
            f"dataset {plan.name} has one class only: every patch is {side} ({', '.join(labels)}); "
            f"a model learns from both, so add a mission that has {other} patches too"
        )


def _content_hash(info: dict[str, Any], patches: pd.DataFrame, frames: pd.DataFrame) -> str:
    header = {name: info[name] for name in (*_HASHED_INFO, "masks") if name in info}
    digest = hashlib.sha256(canonical_json(header).encode())
    placed = _PLACED if info["format_version"] > 1 else []
    for table in (patches[PATCH_COLUMNS], frames[[*_HASHED_FRAME_COLUMNS, *placed]]):
        for start in range(0, max(len(table), 1), _HASHED_AT_ONCE):
            some = table.iloc[start : start + _HASHED_AT_ONCE]
            text = some.to_csv(index=False, header=not start, lineterminator="\n")
            digest.update(text.encode())
    digest.update("".join(sorted({file for file in frames.file if file.endswith(ROWS)})).encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class _StoredFrames:
    """The frames of a plan as they were read."""

    frames: pd.DataFrame  # of `_FRAME_COLUMNS` and `_PLACED`
    unseen: pd.DataFrame  # of `PATCH_KEY`: patches in which nothing is seen, each with the `cause`
    left_out: list[str]  # frames that cannot be read or are damaged, and why
    files: set[str]  # that were written, also of frames that are left out


def _store_frames(folder: Path, sources: Iterable[FrameSource], plan: DatasetPlan) -> _StoredFrames:
    """Copy the frames' files into `folder`, named by pixel hash, and list them.

    Left out are frames that cannot be read, and those of which a run says that a part has no
    picture: a decoder fills a file that was half written with one level. Where most frames of a
    camera are so it is no damage, but a border or a cover: they stay.
    """
    folder.mkdir()
    grid, label = plan.grid, plan.name
    rows, unseen = [], []
    unread: list[str] = []
    blank: dict[tuple[str, str, int], str] = {}
    meter = SightMeter()
    for source in sources:
        name = f"{source.mission}, {source.camera} frame {source.frame}"
        name = source.name if plan.block_frames is None else name
        key = (source.mission, source.camera, source.frame)
        try:
            data, suffix = source.load()
            image = None if source.known is not None else decode_image(data, name)
        except FrameError as error:
            unread.append(str(error))
            continue
        position = source.frame if source.position is None else source.position
        placed = position, source.name
        if image is None:
            assert source.known is not None
            digest, *size = source.known
            (folder / file_name(data)).write_bytes(data)
            rows.append((*key, source.group, digest, file_name(data), *size, *placed))
            continue
        with naming(f"dataset {label}: {name}"):
            grid.patch_size(*grid.resized(*image.shape[:2]))
        digest = pixel_sha256(image)
        file = f"{digest}{suffix}"
        (folder / file).write_bytes(data)
        rows.append((*key, source.group, digest, file, *image.shape[:2], *placed))
        mask = plan.masks.get(source.mission, CameraMasks()).of(source.camera)
        covered = image if mask is None else mask.cover(image)
        sight = meter.measure(covered, mask)
        if sight.fault and sight.blind is not None and sight.blind.cause == FLAT:
            blank[key] = f"{name}: {sight.fault}"
        causes = causes_on_grid(sight, covered, grid)
        unseen += [
            (*key, *divmod(cell, grid.cols), cause) for cell, cause in enumerate(causes) if cause
        ]
    if 2 * len(unread) > len(plan.frames):
        more = f" (and {len(unread) - 1} more of {len(plan.frames)} frames)"
        raise ToktError(f"dataset {label}: {unread[0]}{more if len(unread) > 1 else ''}")
    frames = pd.DataFrame(rows, columns=[*_FRAME_COLUMNS, *_PLACED])
    cameras = list(zip(frames.mission, frames.camera, strict=True))
    times, read = Counter(key[:2] for key in blank), Counter(cameras)
    damaged = {key: why for key, why in blank.items() if 2 * times[key[:2]] <= read[key[:2]]}
    kept = [key not in damaged for key in frames[FRAME_KEY].itertuples(index=False)]
    causes_of = pd.DataFrame(unseen, columns=[*PATCH_KEY, "cause"])
    left_out = [*unread, *damaged.values()]
    return _StoredFrames(frames[kept], causes_of, left_out, set(frames.file))


def _without_contradictions(
    patches: pd.DataFrame, frames: pd.DataFrame
) -> tuple[pd.DataFrame, int]:
    """The patches but those whose very picture has another label too, and how many these are."""
    keyed = patches.merge(frames[[*FRAME_KEY, "digest"]], on=FRAME_KEY, how="left")
    labels = keyed.groupby(["digest", "row", "col"]).label.transform("nunique").to_numpy()
    return patches[labels == 1].reset_index(drop=True), int((labels > 1).sum())


def _unseen_clear(plan: DatasetPlan, unseen: pd.DataFrame) -> dict[str, int]:
    """Number of patches that are labelled clear though nothing is seen in them, by the cause."""
    clear = plan.patches[~plan.patches.label.map(plan.taxonomy.is_obstacle).astype(bool)]
    counts = clear.merge(unseen, on=PATCH_KEY).cause.value_counts()
    return {str(cause): int(count) for cause, count in sorted(counts.items())}


def _summary(plan: DatasetPlan, patches: pd.DataFrame, frames: pd.DataFrame) -> dict[str, Any]:
    masks = {name: plan.masks[name].to_json() for name in sorted(plan.masks)}
    return {
        "format_version": FORMAT_VERSION,
        "name": plan.name,
        "task": plan.task,
        "grid": plan.grid.to_json(),
        "taxonomy": plan.taxonomy.to_json(),
        "block_frames": plan.block_frames,
        "patches": len(patches),
        "frames": len(frames),
        "groups": int(patches.group.nunique()),
        "labels": {str(k): int(v) for k, v in sorted(patches.label.value_counts().items())},
        "frames_that_are_copies": int(frames.digest.duplicated().sum()),
        "unsure_left_out": plan.unsure,
        "sources": plan.sources,
        **({"sites": plan.sites} if plan.sites else {}),
        **({"masks": masks} if masks else {}),
        **({"single_pictures": plan.single_pictures} if plan.single_pictures else {}),
        **({"scene_frames": plan.scene_frames} if plan.scene_frames else {}),
    }


def check_dataset_name(name: str) -> None:
    """Raise ToktError unless `name` can be a dataset's name, also in a path."""
    if not _NAME.fullmatch(name):
        raise ToktError(f"dataset name {name!r}: use letters, digits, '-', '_' and '.'")


def write_dataset(plan: DatasetPlan, root: Path, progress: Callable[..., Any]) -> DatasetVersion:
    """Write a dataset version into the workspace's ``datasets`` folder; the same content once.

    Frames that cannot be read or are damaged are left out, and stand in its `info`.

    Raises ToktError if there is one class only, or a name cannot be used.
    """
    if plan.task not in TASKS:
        raise ToktError(f"task is one of {', '.join(TASKS)}, not {plan.task!r}")
    check_dataset_name(plan.name)
    _check_classes(plan)
    atomic.remove_partials(root, atomic.ABANDONED_S)
    home = root / plan.name
    # Made beside the dataset's own folder, which must not appear before there is a version in it.
    with atomic.scratch_folder(home) as folder:
        sources = progress(plan.frames, len(plan.frames), "reading frames")
        stored = _store_frames(folder / "frames", sources, plan)
        frames = stored.frames.sort_values(DIVE_ORDER, ignore_index=True)
        # Copies of a picture must not stand on both sides of a split.
        frames = frames.assign(group=joined_names(frames.group, frames.digest, "min"))
        placed = frames[[*FRAME_KEY, "group", "position"]]
        patches = plan.patches[[*PATCH_KEY, "label"]].merge(placed, on=FRAME_KEY)
        patches, contradictions = _without_contradictions(patches, frames)
        _check_classes(replace(plan, patches=patches))
        labelled = pd.MultiIndex.from_frame(patches[FRAME_KEY])
        frames = frames[pd.MultiIndex.from_frame(frames[FRAME_KEY]).isin(labelled)]
        frames = frames.reset_index(drop=True)
        for file in set(stored.files) - set(frames.file):
            (folder / "frames" / file).unlink()
        patches = patches[[*PATCH_COLUMNS, "position"]]
        patches = patches.sort_values([*DIVE_ORDER, *PATCH_COLUMNS[3:]], ignore_index=True)
        info = _summary(plan, patches, frames)
        content = _content_hash(info, patches, frames)
        patches.to_parquet(folder / "patches.parquet", index=False)
        frames.to_parquet(folder / "frames.parquet", index=False)
        info["unseen_clear"] = _unseen_clear(replace(plan, patches=patches), stored.unseen)
        info["left_out"] = stored.left_out
        info["contradictions_left_out"] = contradictions
        text = json.dumps({**info, "hash": content}, indent=2) + "\n"
        (folder / "dataset.json").write_text(text, "utf-8")
        found = publish_dataset(folder, home, content)
    target = found.path
    atomic.write_text(home / "latest", target.name + "\n")
    # The same content may have been built before its missions' sites were known.
    sites = {**found.sites, **plan.sites}
    if sites == found.sites:
        return found
    info = {**found.info, "sites": sites}
    atomic.write_text(target / "dataset.json", json.dumps(info, indent=2) + "\n")
    return DatasetVersion(target)


def publish_dataset(folder: Path, home: Path, content: str) -> DatasetVersion:
    """Make a complete folder the version of a dataset with this hash; the same content once.

    Parameters
    ----------
    folder : Path
        Beside `home`; it is gone afterwards, or of no use.
    home : Path
        Of the dataset's versions.
    content : str
        Its hash.
    """
    target = home / content[:HASH_CHARS]
    if not target.exists():
        home.mkdir(exist_ok=True)
        try:
            atomic.publish_folder(folder, target)
        except OSError:
            # Another process may have built the same content meanwhile; theirs is as good.
            if not target.is_dir():
                raise
    return DatasetVersion(target)


def list_datasets(root: Path) -> list[DatasetVersion]:
    """Every dataset version below `root`, by name."""
    return [DatasetVersion(path.parent) for path in sorted(root.glob(f"*/{_VERSION_INFO}"))]


def open_dataset(reference: str, root: Path) -> DatasetVersion:
    """The dataset ``NAME`` (its latest) or ``NAME@HASH`` (a prefix will do), or ToktError."""
    name, _, prefix = reference.partition("@")
    home = root / name
    if not prefix:
        pointer = home / "latest"
        if not pointer.is_file():
            known = ", ".join(sorted(path.parent.name for path in root.glob("*/latest")))
            raise ToktError(
                f"no dataset {name!r} (there are: {known or 'none yet'}); tokt dataset build makes "
                "one"
            )
        return DatasetVersion(home / pointer.read_text("utf-8").strip())
    found = [path.parent for path in home.glob(_VERSION_INFO)]
    fitting = [path for path in found if path.name.startswith(prefix[:HASH_CHARS])]
    if len(fitting) != 1:
        raise ToktError(f"dataset {name!r}: {len(fitting) or 'no'} versions start with {prefix!r}")
    return DatasetVersion(fitting[0])
