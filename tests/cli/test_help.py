"""Help: headings, names of values, and choices that are those of the code."""

import re

import pytest
from typer.main import get_command

from tokt.cli.app import core_app, whole_app
from tokt.features.common.errors import ToktError
from tokt.inference.config import MATCHERS
from tokt.inference.outputs.mavlink import _CHOICES
from tokt.inference.outputs.udp import FORMATS
from tokt.inference.policy.assembly import STEREO_ALGORITHMS
from tokt.inference.policy.policy import POLICIES
from tokt.training.datasets.dataset import TASKS
from tokt.training.datasets.split import BLOCK, DIVE, PATCH
from tokt.training.fitting.presets import PRESETS, weighted
from tokt.training.rig.calibrate.self_calibration import PARTS

VALUE = re.compile(r"(\[NAME=\])?[A-Z][A-Za-z0-9-]*([=,@/.|:]?[A-Za-z0-9-]+)*(\.\.\.)?")


def commands(command, name=""):
    below = getattr(command, "commands", {})
    if not below:
        yield name, command
    for each in below.values():
        yield from commands(each, f"{name} {each.name}".strip())


COMMANDS = dict(commands(get_command(core_app())))


def options_of(name):
    return {each.name: each for each in COMMANDS[name].params if each.opts[0].startswith("-")}


def test_every_command_stands_under_a_heading_in_full(run_tokt):
    helped = run_tokt("--help").out
    titles = re.findall(r"^([A-Z][\w ]+):$", helped, re.MULTILINE)
    assert titles[:3] == ["Options", "Label", "Train and compare"] and "Commands" not in titles
    listed = re.findall(r"^  ([a-z]+)  +[A-Z]", helped, re.MULTILINE)
    whole = get_command(whole_app()).commands
    assert sorted(listed) == sorted(name for name, one in whole.items() if not one.hidden)
    assert {name.split()[0] for name in COMMANDS} <= {*listed}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_value_has_a_name_or_its_choices(name, run_tokt):
    for param in COMMANDS[name].params:
        if getattr(param, "is_flag", False):
            continue
        choices = re.fullmatch(r"[a-z0-9_-]+(\|[a-z0-9_-]+)*", param.metavar)
        assert choices or VALUE.fullmatch(param.metavar), param.metavar
        assert param.help
    usage = " ".join(run_tokt(*name.split(), "--help").out.partition("\n\n")[0].split())
    assert not re.search(r"[<{}]", usage)


def choices(name, option):
    return tuple(options_of(name)[option].metavar.split("|"))


def test_choices_are_those_of_the_code():
    assert choices("run", "policy") == POLICIES
    assert choices("run", "format") == tuple(FORMATS)
    assert choices("run", "stereo") == STEREO_ALGORITHMS
    assert choices("depth", "stereo") == MATCHERS
    for name, known in _CHOICES.items():
        assert choices("run", name) == known
    for name in ("train", "search", "adapt"):
        assert choices(name, "split") == (DIVE, BLOCK)
    assert choices("train", "weight") == (DIVE, PATCH)
    assert choices("dataset build", "task") == TASKS
    assert set(choices("train", "preset")) == PRESETS.keys()
    assert choices("calibrate", "fit") == PARTS
    for name in choices("train", "class_weight"):
        weighted(PRESETS["best"], name)
    with pytest.raises(ToktError, match=", ".join(choices("train", "class_weight"))):
        weighted(PRESETS["best"], "unknown")
