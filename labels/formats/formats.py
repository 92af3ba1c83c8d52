"""The table of label formats: how a file of each is recognised, read and written."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tokt.features.common.errors import ToktError, naming
from tokt.labels.record import LabelRecord

from . import (
    BIIGLE,
    COCO,
    CORALNET,
    CSV,
    CVAT,
    IFDO,
    LABEL_STUDIO,
    PATCHES,
    VIAME,
    biigle,
    coco,
    coralnet,
    cvat,
    ifdo,
    label_studio,
    patch_folder,
    viame_csv,
)
from .frame_metadata import HEADER, YAML, load_ifdo
from .label_csv import COLUMNS, read_label_csv, write_label_csv
from .labels_and_boxes import (
    FoundBox,
    FrameLabels,
    boxes_to_labels,
    labels_to_boxes,
    without_suggestions,
)
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions
from .text_file import csv_rows, read_json, read_rows, read_utf8

_BY_ENDING = {".xml": CVAT, **dict.fromkeys(YAML, IFDO)}
_ENDINGS = "{}: label files end in .csv, .json, .xml or .yaml, folders of patches have no ending"


@dataclass(frozen=True)
class LabelFormat:
    """One format: what people call it, its reader and writer, and how its files' names end."""

    title: str
    read: Callable[[Path, ReadOptions], ImportResult]
    write: Callable[[Path, Iterable[LabelRecord], WriteOptions], ExportResult]
    ending: str = ".csv"


class _BoxFile(Protocol):
    """What the module of a format of boxes has."""

    TITLE: str

    def boxes(
        self, content: Any, options: ReadOptions, who: str, remarks: Remarks, /
    ) -> Iterator[FoundBox]:
        """What is in a file that was loaded; `who` labelled where it does not say."""

    def save(
        self, path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks, /
    ) -> int:
        """Write labels of one mission and return how many."""


_Choose = Callable[[Iterable[LabelRecord], Remarks, str], list[LabelRecord]]
"""Takes the labels that a format, of this title, can hold."""


def _all(records: Iterable[LabelRecord], remarks: Remarks, title: str) -> list[LabelRecord]:
    return list(records)


def _of_boxes(
    form: _BoxFile, load: Callable[[Path], Any], ending: str = ".csv", choose: _Choose = _all
) -> LabelFormat:
    def read(path: Path, options: ReadOptions) -> ImportResult:
        content, remarks = load(path), Remarks()
        with naming(path):
            found = form.boxes(content, options, options.annotator or path.stem, remarks)
            return boxes_to_labels(found, options, remarks)

    def write(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
        remarks = Remarks()
        chosen = choose(records, remarks, form.TITLE)
        frames = labels_to_boxes(chosen, options, remarks, form.TITLE)
        return ExportResult(form.save(path, frames, options, remarks), remarks.lines())

    return LabelFormat(form.TITLE, read, write, ending)


def _read_csv(path: Path, options: ReadOptions) -> ImportResult:
    remarks = Remarks()
    records = read_label_csv(
        *(path, options.taxonomy, options.annotator, options.grid, options.classes, remarks)
    )
    return ImportResult(records, remarks.lines())


def _write_csv(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
    chosen, remarks = list(records), Remarks()
    n = write_label_csv(path, chosen, full=options.full, notes=options.notes)
    if not options.full:
        remarks["label", "without annotator and time (--full keeps them)"] += n
        remarks["model version", "of confirmed suggestions (--full keeps them)"] += sum(
            record.model_version is not None for record in chosen
        )
    return ExportResult(n, remarks.lines())


FORMATS = {
    CSV: LabelFormat("CSV", _read_csv, _write_csv),
    VIAME: _of_boxes(viame_csv, read_rows, choose=viame_csv.of_one_camera),
    COCO: _of_boxes(coco, read_json, ".json"),
    LABEL_STUDIO: _of_boxes(label_studio, read_json, ".json"),
    CORALNET: _of_boxes(coralnet, read_rows, choose=coralnet.of_people_once),
    BIIGLE: _of_boxes(biigle, read_rows, choose=without_suggestions),
    CVAT: _of_boxes(cvat, cvat.read_xml, ".xml", without_suggestions),
    IFDO: _of_boxes(ifdo, load_ifdo, ".json", without_suggestions),
    PATCHES: LabelFormat(
        patch_folder.TITLE, patch_folder.read_patch_folder, patch_folder.write_patch_folder, ""
    ),
}


def format_named(name: str) -> str:
    """Check a format's name; ToktError if there is none of that name."""
    if name not in FORMATS:
        raise ToktError(f"no label format {name!r}; there are {', '.join(FORMATS)}")
    return name


def format_to_write(path: Path) -> str:
    """The format that a file to write has by its name; ToktError if that does not say."""
    suffix = path.suffix.lower()
    if suffix in (".csv", ".xml"):
        return CSV if suffix == ".csv" else CVAT
    if path.is_dir() or not suffix:
        return PATCHES
    if suffix == ".json":
        names = " or ".join(f"--format {name}" for name in (COCO, LABEL_STUDIO, IFDO))
        raise ToktError(f"{path}: say which JSON by {names}")
    raise ToktError(_ENDINGS.format(path))


def format_to_read(path: Path) -> str:
    """The format of a file by its name and content; ToktError if it has none of them."""
    suffix = path.suffix.lower()
    if path.is_dir():
        return PATCHES
    if suffix not in ("", ".csv", ".json", *_BY_ENDING):
        raise ToktError(_ENDINGS.format(path))
    if not path.exists():
        raise ToktError(f"label file {path} does not exist")
    if suffix == ".csv":
        return _kind_of_csv(read_utf8(path))
    if suffix == ".json":
        return _kind_of_json(path)
    if suffix in _BY_ENDING:
        return _BY_ENDING[suffix]
    raise ToktError(_ENDINGS.format(path))


def _kind_of_csv(text: str) -> str:
    """VIAME's has no line of names, or one that begins with ``#``."""
    try:
        _, row = next(csv_rows(text), ("", [""]))
    except ToktError:
        return CSV
    if row[0].startswith("#"):
        return VIAME
    names = {name.strip().lower() for name in row}
    for kind, needed in ((CORALNET, {"name", "row", "column"}), (BIIGLE, {"shape_name", "points"})):
        if needed <= names:
            return kind
    if set(COLUMNS) & set(row) or len(row) < 9:
        return CSV
    return VIAME if row[2].strip().isdigit() else CSV


def _kind_of_json(path: Path) -> str:
    value = read_json(path)
    if isinstance(value, dict) and "images" in value:
        return COCO
    if isinstance(value, dict) and HEADER in value:
        return IFDO
    if isinstance(value, list) or (isinstance(value, dict) and "data" in value):
        return LABEL_STUDIO
    raise ToktError(
        f"{path}: neither COCO (an object with images, annotations, categories) nor Label Studio"
        f" (a list of tasks) nor iFDO (an object with {HEADER})"
    )
