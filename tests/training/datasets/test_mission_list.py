"""A list of missions: what it gives the commands, and what it must not say."""

import json
from pathlib import Path

import pytest

from tests.calls import refuses
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.mission_list import NamedMission, named_missions

TABLE = '[[mission]]\nname = "a"\ndir = "x"\n'


@pytest.fixture
def listed(tmp_path):
    def write(text):
        (tmp_path / "missions.toml").write_text(text, "utf-8")
        return tmp_path

    return write


def test_paths_start_from_the_lists_folder(listed, tmp_path):
    folder = listed(
        '[[mission]]\nname = "dive 7"\ndir = "x/frames"\nlabels = ["l.csv", "/m.csv"]\n'
        'cameras = "left"\nsite = "fjord"\ndate = 2016-04-20\n'
        '[[mission]]\nname = "b"\ndir = "/video.mp4"\nlabels = "n.csv"\ndate = "spring"\n'
    )
    labels = (tmp_path / "l.csv", Path("/m.csv"))
    first = (tmp_path / "x/frames", "dive 7", labels, ("left",), "fjord", "2016-04-20")
    video = Path("/video.mp4")
    second = NamedMission(video, "b", (tmp_path / "n.csv",), date="spring")
    assert named_missions(folder) == [NamedMission(*first), second]
    other = folder / "missions.toml"
    assert named_missions(other.rename(folder / "season.toml")) == named_missions(
        other.parent / "season.toml"
    )
    assert named_missions("a=x") == [NamedMission(Path("x"), "a")]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"has \[\[mission\]\] tables and nothing else"),
        ("mission = 3", "and nothing else"),
        ("[[mission]", "missions.toml: "),
        (TABLE + "x = " + "[" * 2000, "missions.toml: "),
        (TABLE + 'place = "x"', "mission 1: unknown key 'place'; known: name, dir, site, date, "),
        (TABLE + TABLE + "labels = 3", "mission 2: labels is text, not 3"),
        (TABLE + "site = 2016-04-20", "mission 1: site is text"),
        (TABLE + 'labels = "a\\u0000"', "mission 1: labels is text"),
        (TABLE + "date = 3", "mission 1: date is text"),
        (TABLE + 'cameras = ["rear"]', "cameras are left and right, not rear"),
        ('[[mission]]\ndir = "a"', "mission 1 needs a name and a dir"),
    ],
)
def test_refused_lists(listed, text, words):
    refuses(words, named_missions, listed(text))


def test_a_dataset_from_a_list(tiny, own_tiny, tmp_path, done, refused, listed):
    """Both label files call their dive alike; one dive has a site."""
    place = f'labels = "{tiny.labels}"\nsite = "fjord"\ndate = 2016-04-20\ncameras = ["left"]\n'
    first = f'[[mission]]\nname = "first"\ndir = "{tiny.path}"\n'
    second = f'[[mission]]\nname = "second"\ndir = "{own_tiny.path}"\n'
    space = ("--workspace", tmp_path / "ws", "--block", 4)
    build = ("dataset", "build", "d", "--mission", listed(first + place + second), *space)
    refused("labels.db", *build)  # of the second
    refused("no labels for mission 'second'", *build, "--labels", own_tiny.labels)
    listed(first + place + second + f'labels = ["{own_tiny.labels}"]\n')
    info = json.loads(done(*build, "--json").out)
    assert info["sources"][:2] == ["mission first, 2016-04-20", "mission second"]
    assert "sites: first fjord\n" in done("dataset", "show", "d", *space[:2]).out
    dataset = open_dataset("d", tmp_path / "ws" / "datasets")
    assert dataset.sites == info["sites"] == {"first": "fjord"}
    assert set(dataset.frames.mission) == {"first", "second"}
    listed(first + place.replace("left", "right"))
    refused("mission 'first' has no right camera", *build)
