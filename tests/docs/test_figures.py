"""Every figure of a training and of an evaluation stands in the table that explains it."""

import json
import re
from collections.abc import Mapping
from pathlib import Path

from tests.calls import succeeds

PAGE = Path(__file__).resolve().parents[2] / "docs/reference/figures.md"


def told(*arguments):
    return json.loads(succeeds(*arguments, "--json").out)


def keys(figures, *inner):
    for key, value in figures.items():
        yield key
        if key in inner and isinstance(value, Mapping):
            yield from keys(value, *inner)


def test_each_key_is_explained(workspace, tiny):
    where = ("--workspace", workspace)
    trained = told("train", "tiny", "--preset", "plain", "--name", "figures", *where)["cv"]
    labelled = ("--mission", tiny.path, "--labels", tiny.labels)
    evaluated = told("evaluate", "figures", *labelled, *where)
    explained = set(re.findall(r"`(\w+)`", PAGE.read_text("utf-8")))
    parts = ("patch", "frames", "frames_at_zero")
    shown = {*keys(trained, *parts), *keys(evaluated, *parts)} - {"patch"}
    assert shown - explained == set()
