"""Help: headings, names of values, and choices that are those of the code."""

import re

import pytest
from typer.main import get_command

from tokt.cli.app import app, whole_app
from tokt.cli.help import _FEW, _HEADINGS, _NAMED, _OTHERS
from tokt.features.common.errors import ToktError
from tokt.inference.config import MATCHERS, OPTIONS
from tokt.inference.outputs.mavlink import _CHOICES
from tokt.inference.outputs.udp import FORMATS
from tokt.inference.policy.assembly import STEREO_ALGORITHMS
from tokt.inference.policy.policy import POLICIES
from tokt.training.datasets.dataset import TASKS
from tokt.training.fitting.cross_validation import BLOCK, DIVE, PATCH
from tokt.training.fitting.presets import PRESETS, weighted
from tokt.training.rig.calibrate.self_calibration import PARTS

VALUE = re.compile(r"(\[NAME=\])?[A-Z][A-Za-z0-9-]*([=,@/.|:]?[A-Za-z0-9-]+)*(\.\.\.)?")


def commands(command, name=""):
    below = getattr(command, "commands", {})
    if not below:
        yield name, command
    for each in below.values():
        yield from commands(each, f"{name} {each.name}".strip())


COMMANDS = dict(commands(get_command(app)))


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


@pytest.mark.parametrize("group", ["", "labels", "dataset", "models"])
def test_the_list_of_commands_cuts_no_sentence_off(group, run_tokt):
    rows = run_tokt(*group.split(), "--help").out.partition("exit.\n")[2]
    assert rows and "..." not in rows


def test_headings_and_values_are_of_parameters_that_there_are():
    params = [
        (name.split()[-1], param.name) for name in COMMANDS for param in COMMANDS[name].params
    ]
    known = {name for _, name in params} | {f"{command}.{name}" for command, name in params}
    listed = " ".join(_HEADINGS.values()).split()
    assert len(listed) == len(set(listed)) and set(listed) <= known
    assert _NAMED.keys() <= known


@pytest.mark.parametrize("name", COMMANDS)
def test_many_options_stand_under_headings(name, run_tokt):
    options = options_of(name)
    helped = run_tokt(*name.split(), "--help").out
    titles = re.findall(r"^([A-Z][\w ]+):$", helped, re.MULTILINE)
    assert titles[-1] == _OTHERS
    if len(options) > _FEW:
        assert len(set(titles) - {"Arguments", _OTHERS}) >= 1
        assert len({each.rich_help_panel for each in options.values()}) <= len(options) / 2
    for title, part in zip(
        titles, re.split(r"^[A-Z][\w ]+:$", helped, flags=re.M)[1:], strict=True
    ):
        mine = {each.rich_help_panel or _OTHERS for each in options.values()} & {title}
        for each in options.values():
            if mine and (each.rich_help_panel or _OTHERS) == title:
                assert re.search(rf"^  .*{each.opts[-1]}\b", part, re.MULTILINE)


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


def test_the_runtimes_defaults_are_choices():
    for option in OPTIONS.values():
        values = option.metavar.split("|")
        if len(values) > 1 and values[0].islower():
            assert option.default in values
