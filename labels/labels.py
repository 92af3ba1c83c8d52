"""Labels: the records of a label file or of a label store, as one object."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

from tokt.features.common.extras import needed_by
from tokt.features.common.names import same_text
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import LEFT, open_mission

from .formats import CSV
from .formats.formats import FORMATS, format_named, format_to_read, format_to_write
from .formats.images import MissionImages
from .formats.options import Progress, ReadOptions, WriteOptions, no_progress
from .record import HUMAN, LabelRecord
from .store.store import FILE_NAME, AddResult, LabelStore
from .taxonomy import Taxonomy, load_taxonomy

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Labels:
    """Label records, and what they mean.

    Examples
    --------
    >>> labels = tokt.Labels.read("dive/labels.csv")  # doctest: +SKIP
    >>> labels.counts()  # doctest: +SKIP
    {'ocean': 8210, 'subsea_installation': 910}
    >>> labels.write("labels.json", format="coco", mission_dir="dive")  # doctest: +SKIP
    """

    records: tuple[LabelRecord, ...]
    taxonomy: Taxonomy = field(default_factory=Taxonomy.load)  # the classes there may be
    format: str = ""  # of the file that they were read from; empty for a store's
    lost: tuple[str, ...] = ()  # what of the file could not be taken over, a line each
    # The annotator that was taken from the file's name, as nothing else says who labelled.
    assumed: str = ""

    @classmethod
    def read(
        cls,
        file: str | Path,
        *,
        format: str | None = None,
        annotator: str | None = None,
        grid: Grid | str = "10x10@360",
        mission_dir: str | Path | None = None,
        mission: str | None = None,
        folder: str | None = None,
        camera: str = LEFT,
        classes: Mapping[str, str] | None = None,
        taxonomy: str | Path | None = None,
        workspace: str | Path = ".tokt",
    ) -> Self:
        """Read a label file, or a folder of patches, of any format of ``tokt labels import``.

        Parameters
        ----------
        file : str or Path
        format : str, optional
            Its format; by default told by ending and content.
        annotator, grid, camera
            Who labelled, the grid of boxes and the camera, where the file does not say.
        mission_dir, mission, folder
            Folder of the mission's frames, which all formats but CSV need; the mission's name; what
            the file calls the folder, where that is another name than these.
        classes : mapping, optional
            The file's name of a class to ours; to an empty string for a class to leave out.
        taxonomy, workspace
            The taxonomy's file; by default the workspace's, else the built-in one.

        Raises
        ------
        ToktError
            If a line of the file cannot be used.
        """
        known = load_taxonomy(Path(workspace), Path(taxonomy) if taxonomy else None)
        chosen = format_named(format) if format else format_to_read(Path(file))
        cells, images = Grid.parse(str(grid)), images_in(mission_dir, mission, folder)
        options = ReadOptions(known, annotator, cells, images, classes or {}, camera)
        read = FORMATS[chosen].read(Path(file), options)
        named_by = assumed_annotator(Path(file), annotator, read.records)
        return cls(tuple(read.records), known, chosen, tuple(read.lost), named_by)

    @classmethod
    def stored(cls, workspace: str | Path = ".tokt", **wanted: str) -> Self:
        """The labels in force in a workspace's label store, settlements among them.

        `wanted` narrows them: ``mission``, ``annotator``, ``camera``. Raises ToktError if there is
        no store.
        """
        with LabelStore(Path(workspace) / FILE_NAME, create=False) as store:
            records = store.current_and_settled(**wanted)
        return cls(tuple(records), load_taxonomy(Path(workspace)))

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[LabelRecord]:
        return iter(self.records)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} records: {self.counts()})"

    def counts(self) -> dict[str, int]:
        """Records by class, by name."""
        return dict(sorted(Counter(str(record.label) for record in self.records).items()))

    def to_pandas(self) -> "pd.DataFrame":
        """One row a record: mission, camera, frame, grid (text), row, col, label, annotator, ..."""
        with needed_by("Labels.to_pandas"):
            import pandas as pd
        rows = [{**vars(one), "grid": str(one.grid)} for one in self.records]
        return pd.DataFrame(rows, columns=[*LabelRecord.__match_args__])

    def add_to(self, workspace: str | Path, progress: Progress = no_progress) -> AddResult:
        """Add them to a workspace's label store, which is made where there is none.

        ToktError where it would replace labels, and nothing says who made the file.
        """
        with LabelStore(Path(workspace) / FILE_NAME) as store:
            records = progress(self.records, len(self), "import")
            return store.add_counted(records, assumed=self.assumed)

    def write(
        self,
        file: str | Path,
        *,
        format: str | None = None,
        full: bool = False,
        mission_dir: str | Path | None = None,
        mission: str | None = None,
    ) -> list[str]:
        """Write them to a file of a format; notes of annotators stay in the store.

        Parameters are as for `read`; `full` adds who said it, when and how to a CSV file. Returned
        is what the format cannot hold, a line each. Raises ToktError if it cannot say them, or the
        file cannot be written.
        """
        chosen = format_named(format) if format else format_to_write(Path(file))
        options = WriteOptions(self.taxonomy, images_in(mission_dir, mission), full)
        plain = chosen == CSV and not full
        records = [one for one in self.records if one.source == HUMAN or not plain]
        return FORMATS[chosen].write(Path(file), records, options).lost


def images_in(
    mission_dir: str | Path | None, name: str | None, folder: str | None = None
) -> MissionImages | None:
    """The frames of a mission's folder, under the name that labels give it."""
    return None if mission_dir is None else MissionImages(open_mission(mission_dir), name, folder)


def assumed_annotator(file: Path, given: str | None, records: Iterable[LabelRecord]) -> str:
    """The file's name, where labels by people carry it as nothing else says who labelled."""
    by = same_text(file.stem)
    people = (one for one in records if one.source == HUMAN)
    return by if given is None and any(one.annotator == by for one in people) else ""
