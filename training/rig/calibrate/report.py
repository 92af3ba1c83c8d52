"""The report of a self-calibration: one HTML file that needs no other."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import jinja2

from tokt import __version__
from tokt.features.common import atomic
from tokt.features.frames.mission import Mission
from tokt.training.evaluation.plots import data_uri

from . import plots as plots
from .self_calibration import SelfCalibration


def write_report(target: Path, found: SelfCalibration, mission: Mission) -> None:
    """Write the report, whole or not at all."""
    template = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).from_string(resources.files(__package__).joinpath("report.html").read_text("utf-8"))
    clearest = max(found.test_matches, key=len)
    page = template.render(
        found=found,
        version=__version__,
        before=found.before.by_region(),
        after=found.after.by_region(),
        figures={
            "histogram": data_uri(plots.error_histogram(found)),
            "over_frame": data_uri(plots.error_over_frame(found)),
            "path": data_uri(plots.path_and_depth(found)),
            "pair": data_uri(plots.rectified_pair(found, mission, clearest)),
        },
    )
    atomic.write_text(target, page)
