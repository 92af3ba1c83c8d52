"""`tokt train`, `tokt adapt` and `tokt search`: one model version, or the best extractor's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.errors import ToktError
from tokt.features.common.terminal import say
from tokt.features.common.workspace import DEFAULT_WORKSPACE
from tokt.inference.reason import unknown_in_words

from .options import (
    DatasetArgument,
    EmbargoOption,
    FixedBoundaryOption,
    FoldsOption,
    JsonOption,
    LabelFilesOption,
    ReportOption,
    WorkspaceOption,
    fields_of,
)
from .output import answer, figure, print_at_sea, print_patches, progress, scores, unseen_in_words
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.models.registry.registry import Registry
    from tokt.training.datasets.dataset import DatasetVersion
    from tokt.training.fitting.adapt import KnownModel
    from tokt.training.fitting.train_options import TrainedVersion

AUTO = "auto"
SplitOption = Annotated[
    str | None,
    Option(
        help="Hold out whole dives (in --folds folds if there are more than 16) or blocks of "
        "frames. Default: dive; block where there is one dive."
    ),
]
SitesOption = Annotated[
    list[str] | None,
    Option(
        help="Dives of one camera and day, held out together; repeatable. Default: the dataset's."
    ),
]
WeightOption = Annotated[
    str | None,
    Option(help="What counts the same in learning: each dive or each patch. Default: dive."),
]
JobsOption = Annotated[int, Option(help="Processes; -1 for one per core.", min=-1)]
DaskOption = Annotated[
    str | None, Option(help="Dask cluster to work on that sees the same files (tcp://HOST:8786).")
]
SignRegistrationOption = Annotated[
    Path | None, Option(help="Sign the registration with this private key.")
]
_RULE = (
    "the simplest within one standard error, and 0.01, of the best (result.json has the rule in "
    "full)"
)


def train(
    dataset: DatasetArgument,
    extractor: Annotated[
        str | None,
        Option(
            help="lbp, haralick, exact names joined by + (lbp_24_8_frame+haralick), or "
            "spec:FILE.json. Default: haralick, the best one with preset best."
        ),
    ] = None,
    preset: Annotated[
        str,
        Option(
            help="Preset of settings; lite is for small computers. Of several dives best means "
            "water, and lite lite_water."
        ),
    ] = "best",
    name: Annotated[
        str | None, Option(help="Name of the model. Default: DATASET-EXTRACTOR.")
    ] = None,
    folds: FoldsOption = None,
    embargo: EmbargoOption = None,
    split: SplitOption = None,
    site: SitesOption = None,
    weight: WeightOption = None,
    max_samples: Annotated[
        int | None,
        Option(
            min=1000,
            help="Patches that a fit learns from at most, drawn by lot; augmented ones are extra. "
            "Default: the preset's, 50000 or fewer.",
        ),
    ] = None,
    class_weight: Annotated[
        str | None,
        Option(help="Weights of the classes; auto is the better one. Default: the preset's."),
    ] = None,
    changes: Annotated[
        str | None,
        Option(
            help="Augmentations to learn from as well, such as gain_0.5,jpeg_60 or random_9, or "
            "none. Default: the preset's."
        ),
    ] = None,
    fixed_boundary: FixedBoundaryOption = False,
    stress: Annotated[
        bool, Option("--stress", help="Test the folds on augmented frames as well.")
    ] = False,
    false_status_rate: Annotated[
        float, Option(help="Highest allowed rate of false statuses per ocean frame.")
    ] = 1e-4,
    confidence: Annotated[
        float, Option(help="Confidence that the rate is kept; 0.5 for the best estimate.")
    ] = 0.5,
    least_patches: Annotated[str, Option(help="Patches that make an alarm of a frame.")] = AUTO,
    frame_rule: Annotated[
        str, Option(help="Alarms that make a status: K of the last N frames.")
    ] = AUTO,
    ocean: Annotated[
        Path | None, Option(help="Ocean image of preset thesis. Default: a clear frame.")
    ] = None,
    other: Annotated[
        Path | None, Option(help="Other image of preset thesis. Default: a rendered one.")
    ] = None,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
    sign: SignRegistrationOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Train, cross-validate and register one model version."""
    given = fields_of(locals())
    from tokt.training.fitting.train_options import TrainOptions
    from tokt.training.fitting.train_options import train as train_version

    version = train_version(TrainOptions(**given), progress=progress)

    def show() -> None:
        _print_training(version)
        _print_result(version)

    answer(json, version.to_json(), show)


def adapt(
    model: Annotated[
        str,
        Argument(
            help="Registered model, NAME, NAME@ALIAS or NAME/VERSION; or waters, which comes with "
            "tokt and gives a model of its own, named after the dive."
        ),
    ],
    mission: Annotated[
        Path,
        Option(
            metavar="[NAME=]DIR", help="The new dive: folder or video, NAME as its labels call it."
        ),
    ],
    labels: LabelFilesOption = None,
    draws: Annotated[
        int, Option(help="Orders of labelled frames, drawn by lot, in the curve.", min=1)
    ] = 5,
    output: ReportOption = None,
    force: Annotated[
        str | None,
        Option(help="Register the version whatever the old dives lose; the reason is kept."),
    ] = None,
    split: Annotated[
        str | None, Option(help="Hold out dives or blocks of frames. Default: as the model.")
    ] = None,
    site: SitesOption = None,
    jobs: JobsOption = -1,
    sign: SignRegistrationOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Train a model's next version on a new dive as well.

    It tells what that gained there, and cost elsewhere. A version is refused if the F1 of an old
    dive falls by more than 0.03, or their mean by more than 0.01. First label six frames of the
    dive that the page leads to (tokt label DIR --model MODEL).
    """
    from tokt.features.common import atomic
    from tokt.models.registry.load import is_registered_name
    from tokt.models.registry.registry import Registry, check_model_name
    from tokt.models.signing.passphrase import signing_key
    from tokt.training.fitting.adapt import adaptation, is_as_good, with_rate
    from tokt.training.fitting.tracking import adaptation_page, log_adaptation, log_and_register
    from tokt.training.fitting.train import fit_and_measure
    from tokt.training.fitting.train_options import TrainedVersion, compared_with

    if force is not None and not force.strip():
        raise ToktError("--force needs the reason in words")
    packaged, cache = not is_registered_name(model), workspace / "cache"
    registry = Registry(workspace, create=packaged)
    known, key = _known_model(registry, model, workspace / "datasets"), signing_key(sign)
    data, name = _with_new_dive(known, model, mission, labels or [], workspace)
    if packaged:  # a model of its own
        known = replace(known, name=f"{known.name}-{name}")
        check_model_name(known.name)
    asked = split, site or (), force is not None
    found = adaptation(known, data, name, cache, progress, draws, jobs, *asked)
    worse = found.told["worse"]
    if worse and force is None:
        if output:
            atomic.write_text(output, adaptation_page(found.told, f"{known.bundle.name} (refused)"))
        answer(json, {"adaptation": found.told}, lambda: _print_adaptation("The next", found.told))
        raise ToktError(
            f"no version was registered, because of what would be lost: {'; '.join(worse)}. "
            f"Check the labels of {name}, or give --force WHY"
        )
    trained = fit_and_measure(found.request, cache, progress, jobs)
    version = TrainedVersion(log_and_register(trained, registry, key), trained, workspace)
    # What was allowed is by fits with the old folds' C and prior; these are the version's own.
    if not packaged:
        version = compared_with(version, registry.find(known.bundle.label), registry)
    told = with_rate({**found.told, "forced": force}, version.operating_point)
    log_adaptation(told, version.registered, registry)
    if output:
        atomic.write_text(output, adaptation_page(told, version.label))
    result = {**version.to_json(), "adaptation": told}

    def show() -> None:
        _print_training(version)
        _print_adaptation(version.label, told)
        as_good = known.bundle.label if is_as_good(told["gained"]) else ""
        _print_result(version, told["words"][0], as_good)

    answer(json, result, show)


def _known_model(registry: Registry, model: str, datasets: Path) -> KnownModel:
    """Read the model that the next version goes on from."""
    from tokt.models.registry.load import is_registered_name, load_model
    from tokt.training.fitting.adapt import known_model, packaged_model

    if is_registered_name(model):
        return known_model(registry, model, datasets)
    return packaged_model(load_model(model), datasets)


def _with_new_dive(
    known: KnownModel, model: str, mission: Path, labels: list[Path], workspace: Path
) -> tuple[DatasetVersion, str]:
    """Write the next version of the model's dataset, with a new dive; return it and the dive."""
    from tokt.labels.record import NoLabelsError
    from tokt.training.datasets.dataset import write_dataset
    from tokt.training.datasets.dataset_options import tell_left_out
    from tokt.training.datasets.folds import BLOCK_FRAMES
    from tokt.training.datasets.mission_source import (
        labelled_missions,
        plan_from_missions,
        plan_with,
    )
    from tokt.training.fitting.presets import preset_for

    base = known.dataset
    try:
        missions = labelled_missions([mission], labels, workspace, base.taxonomy, base.grid, say)
        if len(missions) > 1:
            raise ToktError("adapt takes one new dive at a time")
        plan, remarks = plan_from_missions(
            *(base.name, base.task, missions, base.taxonomy, base.grid),
            # That of a model of single pictures says nothing of a sequence.
            block_frames=base.block_frames if (base.block_frames or 1) > 1 else BLOCK_FRAMES,
        )
        if not plan.frames:
            raise NoLabelsError(f"no patch of mission {missions[0].name!r} has a sure label")
    except NoLabelsError as error:
        raise ToktError(
            f"{error}; label six of its frames: tokt label {mission} --model {model}. "
            "Key q leads to the next frame of which the model is unsure"
        ) from None
    for remark in remarks:
        say(f"note: {remark}")
    data = write_dataset(plan_with(base, plan), workspace / "datasets", progress)
    tell_left_out(data, say)
    if preset_for(known.settings.preset, data) != known.settings.preset:
        say(
            f"note: {known.bundle.label} was made for one dive's water, and its features stay; "
            f"tokt train {base.name} makes a model for several"
        )
    return data, missions[0].name


def _print_adaptation(label: str, found: dict[str, Any]) -> None:
    before, dive = found["before"], found["mission"]
    print(f"{label} beside {before}, which did not learn of {dive}:")
    print(f"  (both by the folds and settings of {before}; the figures above are by {label}'s own)")
    for words in found["words"]:
        print(f"  {words}")
    print(f"  F1 on the frames of {dive} not learnt from, which get fewer row by row:")
    print("  labelled frames   F1: mean  worst  queue   before")
    for one in found["curve"]:
        print(
            f"  {one['labelled']:15}  {figure(one['mean']):>9}  {figure(one['worst']):>5}  "
            f"{figure(one['queue']):>5}   {figure(one['before']):>6}"
        )
    print(f"  mean, worst: labelled in orders by lot; queue: in that of key q; before: {before}")


def _print_training(version: TrainedVersion) -> None:
    metrics = version.metrics
    patch, frames = metrics["patch"], metrics["frames"]
    print(f"{version.label} (alias challenger)")
    print_patches(patch)
    if patch["f1"] is not None:
        print("  F1 by fold: " + ", ".join(figure(fold["f1"]) for fold in metrics["folds"]))
    if "dives" in metrics:
        _print_dives(metrics)
    if patch["f1"] is not None and version.trained.request.dataset.block_frames is not None:
        print(f"  at operating points that were chosen without them: {_frames(frames)}")
        print_at_sea(frames, "    ")
        print(f"  any patch over 0 an alarm: {_frames(metrics['frames_at_zero'])}")
    if unseen := metrics.get("unseen"):
        print(f"  {unseen_in_words(unseen)}")
        for line in unknown_in_words(unseen["reasons"]):
            print(f"    {line}")
    for name, one in metrics.get("stress", {}).items():
        print(
            f"  on pictures changed by {name}: F1 {figure(one['f1'])}, false status in "
            f"{one['false_status']} of {one['ocean_frames']} ocean frames, "
            f"{one['detected']} of {one['obstacle_frames']} obstacle frames found"
            f"{' (learnt from)' if one['learnt'] else ''}"
        )
    point = version.operating_point
    print(f"  operating point: {point.rule.words()}")
    print(f"  {point.chosen['words']}")
    if version.worse:
        print(f"  WORSE than {version.before} on its dives: {'; '.join(version.worse)}")
    if not metrics["converged"]:
        print("  the solver stopped at its iteration limit (unscaled features)")
    print(f"  how this was measured: {metrics['split']}")


def _print_result(version: TrainedVersion, gained: str = "", as_good: str = "") -> None:
    """Print what a training came to, last, where people look."""
    from tokt.training.fitting.result_words import result_in_words

    print()
    for line in result_in_words(version.label, version.trained, gained, as_good):
        print(line)


def _print_dives(metrics: dict[str, Any]) -> None:
    mean = metrics["over_dives"]
    left_out = f", {mean['without_f1']} with one side only left out" if mean["without_f1"] else ""
    print(
        f"  over {mean['n']} dives{left_out}: mean F1 {figure(mean['f1'])}, mean AP "
        f"{figure(mean['average_precision'])}, mean macro-F1 {figure(mean['macro_f1'])}, worst F1 "
        f"{figure(mean['worst_f1'])} ({mean['worst'] or '-'})"
    )
    for what in ("dives", "sites"):
        for name, one in metrics.get(what, {}).items():
            print(
                f"    {what[:-1]} {name}: {scores(one)}, macro-F1 {figure(one['macro_f1'])}; "
                f"{one['obstacles']} of {one['n']} patches obstacles"
            )


def _frames(frames: dict[str, Any]) -> str:
    words = (
        f"false status in {frames['false_status']} of {frames['ocean_frames']} ocean frames, "
        f"{frames['detected']} of {frames['obstacle_frames']} obstacle frames found"
    )
    first = ", ".join(
        f"{mission} {'never' if frame is None else f'frame {frame}'}"
        for mission, frame in frames["first_detection"].items()
    )
    return f"{words}, first three in a row from {first}" if first else words


def search(
    dataset: DatasetArgument,
    name: Annotated[
        str | None, Option(help="Name of the winning model. Default: DATASET-search.")
    ] = None,
    space: Annotated[
        Path | None,
        Option(
            help="Space file: extractors, C and class weights to try. Default: the built-in one."
        ),
    ] = None,
    budget: Annotated[
        str | None,
        Option(help="Begin no trial after this time (30m, 2h) or number of trials (12)."),
    ] = None,
    nested: Annotated[
        bool,
        Option(
            "--nested",
            help="Repeat the search inside each training part as well, for an honest score.",
        ),
    ] = False,
    fresh: Annotated[
        bool, Option("--fresh/--resume", help="Discard finished trials, or resume from them.")
    ] = False,
    folds: FoldsOption = None,
    embargo: EmbargoOption = None,
    split: SplitOption = None,
    site: SitesOption = None,
    weight: WeightOption = None,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Search extractors; train and register the simplest good one.

    Each extractor is scored by cross-validation, as `train` does it. A search that was stopped goes
    on.
    """
    from tokt.models.registry.registry import Registry, check_model_name
    from tokt.training.datasets.dataset import open_dataset
    from tokt.training.datasets.split import Split
    from tokt.training.search.search import SearchRequest, budget_from
    from tokt.training.search.search import search as search_task
    from tokt.training.search.space import BUILT_IN, read_space

    data = open_dataset(dataset, workspace / "datasets")
    model_name = name or f"{data.name}-search"
    check_model_name(model_name)
    tried, limit = read_space(space or BUILT_IN), budget_from(budget)
    folded = Split.of(data, folds, embargo, split, weight, site or ())
    request = SearchRequest(
        data, model_name, tried, folded, workspace, limit, nested, fresh, jobs, dask
    )
    result = search_task(request, Registry(workspace, create=True), progress)
    answer(json, result, lambda: _print_search(result, nested))


def _print_search(result: dict[str, Any], nested: bool) -> None:
    winner, label = result["winner"], "{name}/{version}".format(**result["model"])
    width = max(len(rank["extractor"]) for rank in result["ranks"])
    print(f"{'extractor':<{width}}  features      score  below the best")
    for rank in result["ranks"]:
        mark = " within reach of the best" if rank["within_reach"] else ""
        if rank["extractor"] == winner["extractor"]:
            mark = " <- winner"
        print(
            f"{rank['extractor']:<{width}}  {rank['features']:>8}  {rank['score']:.3f} ± "
            f"{rank['standard_error']:.3f}  {rank['shortfall']:.3f} ± "
            f"{rank['shortfall_error']:.3f}{mark}"
        )
    for name, fault in result["faults"].items():
        print(f"{name}: not tried: {fault}")
    print(f"{label} (alias challenger): {winner['extractor']}, {_RULE}")
    print(f"  {result['selection']}")
    left = result["trials"] - result["tried"] - len(result["faults"])
    if left:
        print(f"  {result['tried']} of {result['trials']} tried; the same command tries the rest.")
    elif nested and result["nested"] is None:
        print("  --nested is not finished; the same command goes on with it.")
    print(f"  spec: --extractor spec:{result['winner_file']}")
