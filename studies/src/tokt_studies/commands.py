"""The commands that measure or try out tokt: `tokt demo`, `simulate`, `reproduce`, `bench`."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from tokt.cli.help import Commands
from tokt.cli.options import JsonOption, is_written
from tokt.cli.output import answer, progress
from tokt.cli.output import print_line as print
from tokt.features.common.errors import ToktError
from tokt.features.common.terminal import say

if TYPE_CHECKING:
    from tokt_studies.simulation.rendering.synthetic_mission import SyntheticMission

ProcessesOption = Annotated[
    int | None, Option("--jobs", help="Processes. Default: one per core.", min=1)
]
File = Path | None
_NOT_EXACT = 1
_LoopOption = partial(Option, rich_help_panel="Closed loop")
_ImageOption = partial(Option, metavar="IMAGE", rich_help_panel="Images")
"""Options under headings of their own in the help."""
_FOR_MISSIONS = ("frames", "pipeline")
_FOR_TIMES, _FOR_COUNT = ("mission", "labels", "calibration", "frames", "quick"), ("preset",)
_FOR_CLOSED_LOOP = ("scenes", "methods", "runs", "model", "planner")


def demo(
    mission: Annotated[
        File, Option(metavar="[NAME=]DIR", help="Mission to use. Default: a rendered one.")
    ] = None,
    labels: Annotated[File, Option(help="Label file of the mission.")] = None,
    out: Annotated[Path, Option(help="Output folder; emptied first.")] = Path("demo-out"),
    frames: Annotated[int, Option(help="Stereo pairs of the rendered mission.", min=60)] = 120,
    width: Annotated[
        int, Option(metavar="PX", help="Width in pixels of the rendered frames.", min=360, max=1360)
    ] = 1360,
    json: JsonOption = False,
) -> None:
    """Run the whole chain, from labels to datagrams; write a report."""
    from tokt_studies.demo.demo import run_demo

    if (mission is None) != (labels is None):
        raise ToktError("--mission and --labels go together")
    result = run_demo(out, mission, labels, frames, width, progress, say)
    answer(json, result, lambda: _print_demo(result, out / "report.html"))


def _print_demo(result: dict[str, Any], report: Path) -> None:
    """Print what a demo found, in five lines."""
    from tokt.training.fitting.result_words import at_sea_in_words

    held, champion = result["held_back"][result["champion"]], result["champion"]
    patch, mission = held["patch"], result["mission"]
    doubt = f"another dive: these frames are of {mission}, from which it learnt"
    if result["rendered"]:
        doubt = "any real dive: a rendered one shows that the chain works, and no more"
    say(f"Made: {len(result['held_back'])} models of {mission}. The champion is {champion}.")
    say(
        f"How good: of the obstacle patches in frames held back it finds {patch['recall']:.0%}. "
        f"Of those that it calls obstacles {patch['precision']:.0%} are (F1 {patch['f1']:.3f})."
    )
    say(f"At sea: {at_sea_in_words(held['frames'])}")
    say(f"Not known: how it does on {doubt}.")
    say(f"Next: look at {report}. Then, with pictures of your own: tokt label DIR --model waters")


def simulate(
    context: typer.Context,
    folder: Annotated[
        Path,
        Argument(metavar="DIR", help="New folder to write, or one of a closed loop to go on with."),
    ],
    seed: Annotated[
        int,
        Option(
            help="Seed; the same one gives the same bytes. In the closed loop: of the first run."
        ),
    ] = 1,
    frames: Annotated[
        int | None,
        Option(help="Number of stereo pairs to render. Default: 120, 400 along a pipeline."),
    ] = None,
    pipeline: Annotated[
        bool,
        Option("--pipeline", help="Render a dive along a pipeline with known faults, no approach."),
    ] = False,
    width: Annotated[
        int | None,
        Option(
            metavar="PX",
            help="Frame width in pixels. Default: 1360 for a mission, 360 in the closed loop.",
        ),
    ] = None,
    closed_loop: Annotated[
        bool,
        _LoopOption(
            "--closed-loop",
            help="Fly a vehicle that tokt run steers, instead of rendering a mission.",
        ),
    ] = False,
    scenes: Annotated[
        str | None, _LoopOption(help="Scenes, separated by commas. Default: all but anchor.")
    ] = None,
    methods: Annotated[
        str | None, _LoopOption(help="Any of texture,disparity,either,fallback,none. Default: all.")
    ] = None,
    runs: Annotated[int, _LoopOption(help="Number of runs of each scene and method.")] = 5,
    model: Annotated[
        File, _LoopOption(help="Model to fly. Default: one trained on rendered missions.")
    ] = None,
    planner: Annotated[
        str,
        Option(
            help="tokt, or the thesis's rule: labview (till the obstacle is out of view), "
            "labview-timed, sea-trial (with its fault: the waypoint in the wrong frame)."
        ),
    ] = "tokt",
    jobs: ProcessesOption = None,
    json: JsonOption = False,
) -> None:
    """Render a synthetic mission, or fly the closed loop.

    A mission has exact labels, masks and depth, or labels and a list of faults. A closed loop that
    was cut short goes on in its folder, and what is flown there later joins it.
    """
    for name in _FOR_MISSIONS if closed_loop else _FOR_CLOSED_LOOP:
        if is_written(context, name):
            where = "for a mission, not for --closed-loop" if closed_loop else "for --closed-loop"
            raise ToktError(f"--{name} is {where}")
    if not closed_loop:
        _render(folder, seed, frames, pipeline, width, jobs, json)
        return
    from tokt_studies.simulation.loop.flight import METHODS, WIDTH
    from tokt_studies.simulation.loop.scenes import ANCHOR, KINDS
    from tokt_studies.simulation.study import Study, fly_study

    if runs < 1:
        raise ToktError(f"at least one run is needed, not {runs}")
    if seed < 0:
        raise ToktError(f"a seed is 0 or more, not {seed}")
    study = Study(
        out=folder,
        scenes=_named(scenes, tuple(name for name in KINDS if name != ANCHOR)),
        methods=_named(methods, METHODS),
        seeds=range(seed, seed + runs),
        width=WIDTH if width is None else width,
        model=model,
        jobs=-1 if jobs is None else jobs,
        planner=planner,
    )
    came = fly_study(study, progress, say)
    answer(json, came.to_json(), lambda: list(map(print, came.words())))


def _named(text: str | None, default: tuple[str, ...]) -> tuple[str, ...]:
    if text is None:
        return default
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _render(
    folder: Path, seed: int, frames: int | None, pipeline: bool, width: int | None,
    jobs: int | None, json: bool,
) -> None:  # fmt: skip
    from tokt_studies.simulation.rendering.pipeline_scene import PipelineScene
    from tokt_studies.simulation.rendering.synthetic_mission import MissionScene, simulate_mission
    from tokt_studies.simulation.scene.rig import FULL_WIDTH

    draw, usual = (PipelineScene.draw, 400) if pipeline else (MissionScene.draw, 120)
    wide = FULL_WIDTH if width is None else width
    many = usual if frames is None else frames
    mission = simulate_mission(
        folder, seed=seed, n_frames=many, width=wide, jobs=jobs, progress=progress, draw=draw
    )
    answer(json, asdict(mission), lambda: _print_mission(mission))


def _print_mission(mission: SyntheticMission) -> None:
    nearest = "never in view" if mission.nearest_m is None else f"nearest {mission.nearest_m:.2f} m"
    print(
        f"{mission.path}: {mission.frames} stereo pairs of {mission.width}x{mission.height}, "
        f"{mission.ocean_frames} of open ocean, {mission.obstacle_frames} with obstacles, {nearest}"
    )
    print("patches: " + ", ".join(f"{count} {label}" for label, count in mission.patches.items()))


def reproduce(
    mission: Annotated[Path, Argument(help="[NAME=]DIR: a folder of frames or a video file.")],
    output: Annotated[
        Path,
        Option("-o", "--output", metavar="DIR", help="Folder for the report, figures and tables."),
    ],
    ocean: Annotated[
        File, Option(help="The thesis's image of open ocean. Default: an early frame.")
    ] = None,
    other: Annotated[
        File, Option(help="The thesis's image of anything else. Default: a rendered texture.")
    ] = None,
    picture: Annotated[
        File,
        _ImageOption(help="Image in bad light for figures 5.6 to 5.8. Default: a rendered river."),
    ] = None,
    picture_mask: Annotated[
        File, _ImageOption(help="Mask of --picture drawn by a person: white where an obstacle is.")
    ] = None,
    calibration: Annotated[
        File, Option(help="Stereo calibration. Default: calibrate from the frames.")
    ] = None,
    camera: Annotated[
        str, Option(help="left or right: the texture methods' camera. Left labels serve both.")
    ] = "left",
    labels: Annotated[
        File, Option(help="Label file (CSV). Default: the mission's labels.csv, if there is one.")
    ] = None,
    model: Annotated[File, Option(help="Bundle (.tokt) that judges the frames as well.")] = None,
    sample: Annotated[
        int, Option(help="Number of frames for slow methods, spread over the mission.", min=1)
    ] = 12,
    jobs: ProcessesOption = None,
    json: JsonOption = False,
) -> None:
    """Reproduce the thesis's tables and figures, beside tokt's own.

    Each says what the thesis printed, what came out, and whether the two agree. SLIC superpixels
    are run on a sample of the frames.
    """
    from tokt_studies.thesis.inputs import ReproduceRequest
    from tokt_studies.thesis.run import run_reproduce

    if picture_mask is not None and picture is None:
        raise ToktError("--picture-mask goes together with --picture")
    images = (ocean, other, picture, picture_mask)
    processes = -1 if jobs is None else jobs
    request = ReproduceRequest(
        mission, output, *images, camera, calibration, labels, model, sample, processes
    )
    results = run_reproduce(request, say, progress)
    answer(json, results, lambda: _print_reproduced(results, output))


def _print_reproduced(results: dict[str, Any], out: Path) -> None:
    for exhibit in results["exhibits"]:
        print(f"{exhibit['section']}: {exhibit['title']}")
        if exhibit["missing"]:
            print(f"  not made: {exhibit['missing']}")
        for claim in exhibit["claims"]:
            print(f"  {claim['agreement']:>20}: {claim['what']}")
            print(f"{'':24}printed {claim['printed']}; came out {claim['found']}")
    print(f"written: {out / 'report.html'}, results.json, tables and pictures, "
          f"in {results['seconds']:.0f} s")  # fmt: skip


def bench(
    context: typer.Context,
    mission: Annotated[
        File, Option(metavar="[NAME=]DIR", help="Mission to measure on. Default: a rendered one.")
    ] = None,
    labels: Annotated[
        File, Option(help="Label file of the mission. Default: its labels.csv.")
    ] = None,
    calibration: Annotated[
        File,
        Option(
            metavar="FILE",
            help="Stereo calibration. Default: calibration.yml in the mission or beside it.",
        ),
    ] = None,
    frames: Annotated[
        int | None, Option(help="Number of frames to compare results on. Default: all.", min=1)
    ] = None,
    out: Annotated[
        Path, Option(help="Folder for bench.json and bench.png, or for count.json.")
    ] = Path("bench-out"),
    quick: Annotated[
        bool, Option("--quick", help="Measure few frames, few times, for a first look.")
    ] = False,
    count: Annotated[
        bool,
        Option(
            "--count",
            help="Take no times: count a run's instructions and bytes moved, by stage, with "
            "valgrind. They do not depend on the machine.",
        ),
    ] = False,
    preset: Annotated[str, Option(help="Preset whose run --count counts.")] = "best",
    json: JsonOption = False,
) -> None:
    """Measure speed against the libraries and the thesis's pipeline.

    Exit code 1: a result is not exact.
    """
    for name in _FOR_TIMES if count else _FOR_COUNT:
        if is_written(context, name):
            raise ToktError(f"--{name} is {'not for' if count else 'for'} --count")
    if count:
        from tokt_studies.speed.count_report import print_counts
        from tokt_studies.speed.instruction_count import run_count

        counted = run_count(out, preset, progress, say)
        answer(json, counted.to_json(), lambda: print_counts(counted))
        return
    if calibration and mission is None:
        raise ToktError("--calibration goes together with --mission")
    from tokt.training.calibration.any_form import read_calibration_file
    from tokt_studies.speed.paired_timing import BenchRequest
    from tokt_studies.speed.report import print_table
    from tokt_studies.speed.run import FULL, QUICK, run_bench

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = replace(extent, compared=frames)
    known = read_calibration_file(calibration, say) if calibration else None
    found = run_bench(out, BenchRequest(mission, labels, known, extent, progress, say))
    answer(json, found.to_json(), lambda: print_table(found.results, found.about))
    say(f"chart: {out / 'bench.png'}")
    if not found.about["exact"]:
        say("tokt: warning: not every case gave the same as the libraries")
        raise typer.Exit(_NOT_EXACT)


app = Commands("studies", "Measure or try out tokt.")
for _command in (demo, simulate, reproduce, bench):
    app.command(rich_help_panel="Studies")(_command)
