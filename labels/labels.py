"""Labels: the records of a label file or of a label store, as one object."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

from tokt.features.common.extras import needed_by
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
        mission_dir, mission
            Folder of the mission's frames, which all formats but CSV need; the mission's name.
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
        cells, images = Grid.parse(str(grid)), images_in(mission_dir, mission)
        options = ReadOptions(known, annotator, cells, images, classes or {}, camera)
        read = FORMATS[chosen].read(Path(file), options)
        return cls(tuple(read.records), known, chosen, tuple(read.lost))

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
        """Add them to a workspace's label store, which is made where there is none."""
        with LabelStore(Path(workspace) / FILE_NAME) as store:
            return store.add_counted(progress(self.records, len(self), "import"))

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


def images_in(mission_dir: str | Path | None, name: str | None) -> MissionImages | None:
    """The frames of a mission's folder, under the name that labels give it."""
    return None if mission_dir is None else MissionImages(open_mission(mission_dir), name)
