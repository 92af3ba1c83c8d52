"""The table of label formats: how a file of each is recognised, read and written."""

import csv
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common.errors import ToktError
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
from .frame_metadata import HEADER, YAML
from .label_csv import COLUMNS, read_label_csv, write_label_csv
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions, lines
from .text_file import csv_rows, read_json, read_utf8

_BY_ENDING = {".xml": CVAT, **dict.fromkeys(YAML, IFDO)}
_ENDINGS = "{}: label files end in .csv, .json, .xml or .yaml, folders of patches have no ending"


@dataclass(frozen=True)
class LabelFormat:
    """One format: what people call it, its reader and writer, and how its files' names end."""

    title: str
    read: Callable[[Path, ReadOptions], ImportResult]
    write: Callable[[Path, Iterable[LabelRecord], WriteOptions], ExportResult]
    ending: str = ".csv"


def _read_csv(path: Path, options: ReadOptions) -> ImportResult:
    remarks: Remarks = Counter()
    records = read_label_csv(
        path,
        options.taxonomy,
        annotator=options.annotator,
        grid=options.grid,
        classes=options.classes,
        remarks=remarks,
    )
    return ImportResult(records, lines(remarks))


def _write_csv(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
    chosen = list(records)
    n = write_label_csv(path, chosen, full=options.full, notes=options.notes)
    remarks: Remarks = Counter()
    if not options.full:
        remarks["label", "without annotator and time (--full keeps them)"] += n
        remarks["model version", "of confirmed suggestions (--full keeps them)"] += sum(
            record.model_version is not None for record in chosen
        )
    return ExportResult(n, lines(remarks))


FORMATS = {
    CSV: LabelFormat("CSV", _read_csv, _write_csv),
    VIAME: LabelFormat(viame_csv.TITLE, viame_csv.read_viame_csv, viame_csv.write_viame_csv),
    COCO: LabelFormat(coco.TITLE, coco.read_coco, coco.write_coco, ".json"),
    LABEL_STUDIO: LabelFormat(
        label_studio.TITLE, label_studio.read_label_studio, label_studio.write_label_studio, ".json"
    ),
    CORALNET: LabelFormat(coralnet.TITLE, coralnet.read_coralnet, coralnet.write_coralnet),
    BIIGLE: LabelFormat(biigle.TITLE, biigle.read_biigle, biigle.write_biigle),
    CVAT: LabelFormat(cvat.TITLE, cvat.read_cvat, cvat.write_cvat, ".xml"),
    IFDO: LabelFormat(ifdo.TITLE, ifdo.read_ifdo_labels, ifdo.write_ifdo, ".json"),
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
    """The format that a file to write has by its name.

    Raises
    ------
    ToktError
        If the name does not say.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return CSV
    if suffix == ".xml":
        return CVAT
    if path.is_dir() or not suffix:
        return PATCHES
    if suffix == ".json":
        names = " or ".join(f"--format {name}" for name in (COCO, LABEL_STUDIO, IFDO))
        raise ToktError(f"{path}: say which JSON by {names}")
    raise ToktError(_ENDINGS.format(path))


def format_to_read(path: Path) -> str:
    """The format that a file has by its name and content.

    Raises
    ------
    ToktError
        If it has none of them, or cannot be read.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        return PATCHES
    if suffix not in ("", ".csv", ".json", ".xml", *YAML):
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
    first = next((line for line in text.splitlines() if line.strip()), "")
    if first.startswith(("#", '"#')):
        return VIAME
    try:
        row: list[str] = next(csv_rows(first), [])
    except csv.Error:
        return CSV
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
