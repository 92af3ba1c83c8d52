"""CompareOptions, and the comparison of models that they describe."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.labels.formats.options import Progress, no_progress
from tokt.labels.taxonomy import load_taxonomy
from tokt.models.registry.load import load_model
from tokt.models.registry.registry import Registry
from tokt.training.datasets.mission_source import labelled_missions
from tokt.training.evaluation.evaluate_options import MissionOptions
from tokt.training.options import Notice, PathOrText, paths, takes, texts

from .comparison import compare_models
from .held_out_predictions import check_different, read_held_out
from .mission_predictions import predict_missions
from .predictions import ComparedModels
from .report import has_registry, log_comparison, report_html


@dataclass(frozen=True)
class CompareOptions(MissionOptions):
    """The options of ``tokt compare``, by its names: its help explains each."""

    models: PathOrText | Sequence[PathOrText]
    output: PathOrText | None = None
    learning_curve: str | None = None
    ceilings: bool = False


@dataclass(frozen=True, repr=False)
class Comparison:
    """What a comparison found."""

    compared: ComparedModels  # the models, and what each said of the patches
    figures: dict[str, Any]  # the JSON object of ``tokt compare --json``
    html: str  # the report, one page that needs no other file
    workspace: Path  # whose registry `log` writes to

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(self.words)})"

    @property
    def words(self) -> list[str]:
        """Which model is better, by how much, and whether the difference is real: a line a pair."""
        words: list[str] = self.figures["words"]
        return words

    def to_pandas(self) -> pd.DataFrame:
        """One row a model: patch and frame figures, and the time a frame; the best first."""
        models = {one["model"]: one for one in self.figures["models"]}
        patch = ("f1", "precision", "recall", "average_precision", "macro_f1")
        frames = ("false_status", "ocean_frames", "detected", "obstacle_frames")
        rows = [
            {
                "model": name,
                **{key: models[name]["patch"][key] for key in patch},
                **{key: (models[name]["frames"] or {}).get(key) for key in frames},
                "median_ms": models[name]["time"]["median_ms"],
            }
            for name in self.figures["ranking"]
        ]
        return pd.DataFrame(rows).set_index("model")

    def log(self) -> str | None:
        """Log figures and report as an MLflow run, and give its id; None without a registry."""
        if not has_registry(self.workspace):
            return None
        registry = Registry(self.workspace)
        return log_comparison(self.compared, self.figures, self.html, registry)


@takes(CompareOptions)
def compare(
    options: CompareOptions, *, progress: Progress = no_progress, notice: Notice = warnings.warn
) -> Comparison:
    """Compare models on the patches that cross-validation held out, or on missions.

    Parameters
    ----------
    options : CompareOptions
        Or its fields, as in the example.
    progress, notice : callable, optional
        As for `build_dataset`.

    Returns
    -------
    Comparison

    Raises
    ------
    ToktError
        If a model, a mission or an option cannot be used, or no patch was held out by all.

    Examples
    --------
    >>> found = tokt.compare(["tower-lbp", "tower-haralick"])  # doctest: +SKIP
    >>> found.to_pandas()  # doctest: +SKIP
    """
    if options.mission and options.ceilings:
        raise ToktError("--ceilings judges what cross-validation held out: leave out --mission")
    output = Path(options.output) if options.output else None
    if output is not None and output.is_dir():
        raise ToktError(f"{output} is a folder; -o names the report's file")
    workspace = Path(options.workspace)
    compared = compared_models(options, progress, notice)
    curve_of = options.learning_curve
    figures = compare_models(compared, workspace, progress, curve_of, options.ceilings)
    html = report_html(compared, figures)
    if output is not None:
        atomic.write_text(output, html)
    return Comparison(compared, figures, html, workspace)


def compared_models(options: CompareOptions, progress: Progress, notice: Notice) -> ComparedModels:
    """Models on what cross-validation held out of all, or on missions."""
    workspace, models = Path(options.workspace), texts(options.models)
    if not options.mission:
        if options.are_stated or options.taxonomy:
            raise ToktError(
                "--labels, --frames, --taxonomy, --rate, --stopping-distance, --calibration and "
                "--log go with --mission"
            )
        return read_held_out(models, workspace)
    classes, wanted = load_taxonomy(workspace, *paths(options.taxonomy)), options.numbers
    bundles = [load_model(model, workspace) for model in models]
    check_different([bundle.label for bundle in bundles], [bundle.sha256 for bundle in bundles])
    named = paths(options.mission), paths(options.labels)
    missions = labelled_missions(*named, workspace, classes, bundles[0].grid, notice)
    stated = options.at_sea(missions, notice)
    return predict_missions(bundles, missions, classes, progress, wanted, stated)
