"""The whole of ``tokt reproduce``: every exhibit from one mission, its files, and the report."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from tokt import __version__
from tokt.features.common import atomic
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.features.common.machine import machine
from tokt.labels.formats.options import Progress
from tokt.training.options import Notice

from .exhibits.calibration_figures import calibration_figures
from .exhibits.centre_figures import centre_and_box
from .exhibits.curve_figures import curve_figures
from .exhibits.disparity_figures import disparity_figures
from .exhibits.dot_figures import prediction_dots
from .exhibits.exhibit import Exhibit, StudyContext
from .exhibits.invariance import invariance
from .exhibits.light_figures import bad_lighting, given_picture
from .exhibits.margin_figures import margin_figures
from .exhibits.patch_figures import patch_histograms
from .exhibits.runtime_tables import runtime_tables
from .exhibits.superpixel_figure import superpixel_figure
from .exhibits.synchrony_figure import synchrony_figure
from .exhibits.training_image_figures import training_images
from .exhibits.trend_figure import trend_exhibit
from .inputs import ReproduceRequest
from .page import write_thesis_page
from .report import FORMAT, exhibit_json, report_html

REPORT, RESULTS, PAGE = "report.html", "results.json", "thesis.md"


class Planned(NamedTuple):
    """An exhibit that is to be made: what it is called, and what makes it of a `StudyContext`."""

    key: str
    title: str
    section: str
    make: Callable[[StudyContext], Exhibit]


EXHIBITS: tuple[Planned, ...] = (
    Planned(
        "figure-3.1-to-3.7",
        "Calibration: straight lines, and rows that agree",
        "section 3.1, figures 3.1 to 3.7",
        calibration_figures,
    ),
    Planned(
        "figure-3.8-to-3.10",
        "Disparity map and point cloud",
        "sections 3.1.6 and 3.1.8, figures 3.8 to 3.10",
        disparity_figures,
    ),
    Planned(
        "figure-3.9",
        "Block matching: false line, number of disparities, cut margin",
        "sections 3.1.6, 3.1.7 and 6.1.1, figures 3.8 and 3.9",
        margin_figures,
    ),
    Planned(
        "figure-3.11-3.12",
        "Histograms of the training images: flat, edge and corner bins",
        "section 3.2.1, figures 3.11, 3.12 and 3.13",
        training_images,
    ),
    Planned(
        "figure-3.16-3.19",
        "Histograms of a patch on the structure and of a patch of ocean",
        "sections 3.2.3 and 3.3, figures 3.15, 3.16, 3.18 and 3.19",
        patch_histograms,
    ),
    Planned(
        "figure-3.17-3.20",
        "Prediction dots over the grid, and the mask",
        "sections 3.2.4 and 3.3, figures 3.17 and 3.20",
        prediction_dots,
    ),
    Planned(
        "section-2.13",
        "LBP and Haralick under grey changes, rotation and noise",
        "sections 2.13 and 7.1",
        invariance,
    ),
    Planned(
        "figure-3.22-3.24",
        "Contours, centre and box of a mask: the thesis's, and corrected",
        "section 3.4, figures 3.21, 3.22, 3.23 and 3.24",
        centre_and_box,
    ),
    Planned("table-5.1-to-5.4", "Run time by method", "Tables 5.1 to 5.4", runtime_tables),
    Planned("figure-5.1", "SLIC superpixels against the grid", "figure 5.1", superpixel_figure),
    Planned(
        "figure-5.3-to-5.5",
        "Mean value along the mission",
        "Figures 5.3 to 5.5; sections 5.2.1 and 7.2",
        curve_figures,
    ),
    Planned(
        "figure-5.6-5.8",
        "Bad light: a person's eye, and every method's predictions",
        "section 5.3, figures 5.6 to 5.8",
        bad_lighting,
    ),
    Planned("figure-6.1", "Are the two cameras synchronous?", "figure 6.1", synchrony_figure),
    Planned(
        "trend",
        "Mean value over time: relative distance, trend and time to contact",
        "sections 5.2.1 and 7.2",
        trend_exhibit,
    ),
)
"""In the order of the report."""


def run_reproduce(
    request: ReproduceRequest,
    say: Notice,
    progress: Progress,
    exhibits: Sequence[Planned] = EXHIBITS,
) -> dict[str, Any]:
    """Make every exhibit and write them into the request's folder; give what results.json holds.

    Writes ``KEY/*.csv`` and ``KEY/*.png`` of each exhibit, ``report.html``, which needs no other
    file, then ``results.json``, and of all `EXHIBITS` ``thesis.md``, the page that docs/thesis.md
    is. Files of these names are replaced, each as a whole. `say` takes a line for people, and
    ``progress(items, total, what)`` passes items on. Raises ToktError if the mission or a file of
    the request cannot be used, or nothing can be written. An exhibit that cannot be made says why,
    and the others are made.
    """
    began = time.monotonic()
    _check_folder(request.out)
    context = StudyContext(request, say, progress)
    _check_inputs(context)
    made = [_made(planned, context) for planned in exhibits]
    results = {
        "format": FORMAT,
        "mission": {
            "name": context.mission.name,
            "frames": len(context.frames),
            "pairs": len(context.pairs),
        },
        "about": about(context),
        "machine": machine(),
        "seconds": round(time.monotonic() - began, 1),
        "exhibits": [exhibit_json(one) for one in made],
    }
    # Of an earlier run; without it nobody takes a half-replaced folder for a whole one.
    (request.out / RESULTS).unlink(missing_ok=True)
    for exhibit in made:
        _write(exhibit, request.out)
    atomic.write_text(request.out / REPORT, report_html(made, results))
    text = json.dumps(results, indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(request.out / RESULTS, text + "\n")
    if exhibits is EXHIBITS:
        _write_page(results, request.out, say)
    return results


def _write_page(results: dict[str, Any], out: Path, say: Notice) -> None:
    """The page from the thesis to this code; it quotes figures that not every mission has."""
    try:
        write_thesis_page(results, out / PAGE)
    except ToktError as error:
        say(f"no {PAGE}: {error}")


def _check_folder(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with -o")
    with os_errors_as(f"cannot write in {out}"):
        out.mkdir(parents=True, exist_ok=True)
        atomic.write_text(out / ".writable", "")
        (out / ".writable").unlink()


def _check_inputs(context: StudyContext) -> None:
    """Use everything that was given once: a mistake in it is said before minutes of work."""
    context.spread()
    if context.request.labels is not None and not context.labels:
        raise ToktError(
            f"{context.request.labels} has no labels of {context.request.camera} frames"
        )
    if context.request.calibration is not None:
        _ = context.calibration
    if context.request.model is not None:
        _ = context.tokt_model
    _ = given_picture(context)
    if context.request.sample > len(context.frames):
        context.say(f"--sample: the mission has {len(context.frames)} frames, all are taken")


def _made(planned: Planned, context: StudyContext) -> Exhibit:
    """An exhibit, or why there is none."""
    context.say(f"-- {planned.section}: {planned.title}")
    began = time.monotonic()
    try:
        exhibit = planned.make(context)
    except ToktError as error:
        exhibit = Exhibit(missing=str(error))
        context.say(f"   not made: {error}")
    context.say(f"   {time.monotonic() - began:.1f} s")
    return replace(exhibit, key=planned.key, title=planned.title, section=planned.section)


def about(context: StudyContext) -> list[str]:
    """What every figure of the run rests on, in lines for people."""
    labels = "without labels"
    if context.labels:
        labels = (
            f"labels{' carried from the left camera' * bool(context.carried_labels)} "
            f"of {len(context.obstacle_patches)} frames, "
            f"{sum(count > 0 for count in context.obstacle_patches.values())} of them with an "
            f"obstacle, {len(context.ocean_frames)} of open ocean all over"
        )
    return [
        f"mission {context.mission.name}: {len(context.frames)} {context.request.camera} frames, "
        f"{len(context.pairs)} stereo pairs; {labels}",
        f"the thesis's models {context.two_images}",
        f"calibration: {context.calibration_words}",
        f"slow methods (SLIC, superpixel colours, run times) on a sample of "
        f"{len(context.spread())} frames, evenly spaced",
        f"made by tokt {__version__} reproduce, every figure computed in this run",
    ]


def _write(exhibit: Exhibit, out: Path) -> None:
    folder = out / exhibit.key
    for table in exhibit.tables:
        text = table.frame.to_csv(index=False, lineterminator="\n", float_format="%.6g")
        atomic.write_text(folder / f"{table.name}.csv", text)
    for plot in exhibit.plots:
        atomic.write_bytes(folder / f"{plot.name}.png", plot.png)
