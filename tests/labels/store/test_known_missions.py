"""Two dives of one name do not mix: their frames are told apart, copies are not."""

import json
import os
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.calls import refuses, succeeds
from tests.fixtures import write_labels, write_video
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import open_mission
from tokt.labels.store.known_missions import FILE_NAME, check_mission, note_mission
from tokt.labels.store.store import LabelStore


def _dive(folder, seed, frames=range(1, 9), suffix="png"):
    for camera in ("Left", "Right"):
        (folder / camera).mkdir(parents=True, exist_ok=True)
        for frame in frames:
            rng = np.random.default_rng((seed, frame, len(camera)))
            image = rng.integers(0, 9, (30, 40), np.uint8)
            cv2.imwrite(str(folder / camera / f"a_{frame}.{suffix}"), image)
    return folder


def _note(workspace, path):
    note_mission(workspace, open_mission(path))


def _words(workspace, path, old):
    return (
        f"the labels of mission {path.stem!r} in {workspace} belong to the frames in"
        f" {old.resolve()}; give another dive its own name (NAME=DIR) or another --workspace"
    )


def _refused(workspace, path, old):
    said = _words(workspace, path, old)
    before = (workspace / FILE_NAME).read_bytes()
    for refuse in (note_mission, check_mission):
        refuses(f"^{re.escape(said)}$", refuse, workspace, open_mission(path))
    assert (workspace / FILE_NAME).read_bytes() == before


@pytest.mark.parametrize("suffix", ["png", "bmp"])  # the latter are all of one size
def test_another_dive_of_the_same_name(tmp_path, suffix):
    one = _dive(tmp_path / "1" / "dive", 1, suffix=suffix)
    other = _dive(tmp_path / "2" / "dive", 2, suffix=suffix)
    _note(tmp_path, one)
    _refused(tmp_path, other, one)
    _note(tmp_path, one)
    other = other.rename(other.parent / "dive 2")
    _note(tmp_path, other)
    assert set(json.loads((tmp_path / FILE_NAME).read_bytes())["missions"]) == {"dive", "dive 2"}


def test_no_frame_in_common(tmp_path):
    one = _dive(tmp_path / "1" / "dive", 1, range(1, 5))
    _note(tmp_path, one)
    _refused(tmp_path, _dive(tmp_path / "2" / "dive", 1, range(5, 9)), one)


def test_a_copy_or_a_moved_folder_is_the_same_dive(tmp_path):
    one = _dive(tmp_path / "1" / "dive", 1)
    _note(tmp_path, one)
    copy = tmp_path / "2" / "dive"
    shutil.copytree(one, copy, copy_function=shutil.copyfile)  # other times
    (copy / "Left" / "a_3.png").unlink()
    _dive(copy, 7, range(20, 22))  # more frames
    check_mission(tmp_path, open_mission(copy))
    _note(tmp_path, copy)
    assert json.loads((tmp_path / FILE_NAME).read_bytes())["missions"]["dive"]["path"] == str(copy)
    shutil.rmtree(one)
    _note(tmp_path, copy.rename(tmp_path / "dive"))


def test_one_other_frame_is_enough_to_refuse(tmp_path):
    one = _dive(tmp_path / "1" / "dive", 1)
    _note(tmp_path, one)
    copy = shutil.copytree(one, tmp_path / "2" / "dive")
    shutil.copy(copy / "Right" / "a_2.png", copy / "Right" / "a_1.png")
    _refused(tmp_path, copy, one)


def test_more_frames_in_the_same_folder(tmp_path, monkeypatch):
    one = _dive(tmp_path / "1" / "dive", 1, range(100, 102))
    _note(tmp_path, one)
    shutil.rmtree(one)
    _dive(one, 1, range(1, 99))  # none of the first ones is left
    check_mission(tmp_path, open_mission(one))
    monkeypatch.chdir(one)
    _note(tmp_path, Path())
    frames = json.loads((tmp_path / FILE_NAME).read_bytes())["missions"]["dive"]["frames"]
    assert len(frames) == 50
    assert {name.split()[0] for name in frames} == {"left", "right"}
    _note(tmp_path, shutil.copytree(one, tmp_path / "2" / "dive"))


def test_nothing_is_written_where_nothing_changed(tmp_path):
    one = _dive(tmp_path / "dive", 1)
    _note(tmp_path, one)
    os.utime(tmp_path / FILE_NAME, (1, 1))
    _note(tmp_path, one)
    assert (tmp_path / FILE_NAME).stat().st_mtime == 1


def test_videos(tmp_path):
    for number, n_frames in ((1, 3), (2, 4)):
        (tmp_path / str(number)).mkdir()
        images = [np.zeros((48, 64, 3), np.uint8)] * n_frames
        write_video(tmp_path / str(number) / "dive.avi", images)
    one = tmp_path / "1" / "dive.avi"
    _note(tmp_path, one)
    _refused(tmp_path, tmp_path / "2" / "dive.avi", one)
    _refused(tmp_path, _dive(tmp_path / "3" / "dive", 1), one)
    (tmp_path / "4").mkdir()
    _note(tmp_path, Path(shutil.copy(one, tmp_path / "4" / "dive.avi")))


def test_frames_that_cannot_be_read_are_left_out(tmp_path):
    one = _dive(tmp_path / "1" / "dive", 1)
    (one / "Left" / "a_4.png").unlink()
    (one / "Left" / "a_4.png").mkdir()
    _note(tmp_path, one)
    other = _dive(tmp_path / "2" / "dive", 1)
    _note(tmp_path, other)


def test_a_newer_format(tmp_path):
    path = _dive(tmp_path / "dive", 1)
    text = json.dumps({"format": 2, "dives": []})
    (tmp_path / FILE_NAME).write_text(text)
    for read in (note_mission, check_mission):
        newer = r"missions.json has format 2, newer .*update tokt$"
        refuses(newer, read, tmp_path, open_mission(path))
    assert (tmp_path / FILE_NAME).read_text() == text


GOOD = '{"format": 1, "missions": {"dive": {"path": "/x", "frames": {"left 1": "3 00"}}}}'


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "\xff", "{", "[" * 100_000, '{"format": 1}'),
        *(GOOD.replace("1,", "true,"), GOOD.replace("1,", "0,"), GOOD.replace("left 1", "left")),
        *(GOOD.replace('"3 00"', "3"), GOOD.replace('"/x"', "null")),
        '{"format": 1, "missions": {"dive": []}}',
        '{"format": 1, "missions": {"dive": {"path": "/x", "frames": ["left 1"]}}}',
    ],
)
def test_damage(tmp_path, text):
    path = _dive(tmp_path / "dive", 1)
    (tmp_path / FILE_NAME).write_bytes(text.encode("latin-1"))
    for read in (note_mission, check_mission):
        refuses(r"missions.json is damaged; ", read, tmp_path, open_mission(path))
    assert (tmp_path / FILE_NAME).read_bytes() == text.encode("latin-1")


def test_a_workspace_that_cannot_be_written(tmp_path):
    path = _dive(tmp_path / "dive", 1)
    (tmp_path / "workspace").touch()
    refuses(r"missions.json: ", _note, tmp_path / "workspace", path)


def _import(folder):
    """A workspace with a label of each frame, and the labels in a file beside it."""
    rows = [["dive", "left", frame, 0, 0, "reef"] for frame in range(1, 9)]
    file = write_labels(folder / "labels.csv", rows)
    succeeds("labels", "import", file, "--workspace", folder / "w")
    return folder / "w"


def test_dataset_build_refuses_another_dive(run_tokt, tmp_path):
    one, other = _dive(tmp_path / "1" / "dive", 1), _dive(tmp_path / "2" / "dive", 2)
    workspace = _import(tmp_path)
    build = ("dataset", "build", "one", "--task", "classes", "--workspace", workspace)
    unknown = run_tokt(*build, "--mission", other)  # nothing noted: as it was
    assert "belong to the frames" not in unknown.err
    assert not (workspace / FILE_NAME).exists()
    _note(workspace, one)
    ran = run_tokt(*build, "--mission", other)
    assert ran.code == 2 and ran.err.startswith("tokt: error: the labels of mission 'dive' in ")
    given = run_tokt(*build, "--mission", other, "--labels", tmp_path / "labels.csv")
    assert "belong to the frames" not in given.err
    assert "belong to the frames" not in run_tokt(*build, "--mission", one).err


def test_the_page_notes_the_mission_that_it_opens(tmp_path):
    pytest.importorskip("fastapi")
    from tokt.features.frames.grid import Grid
    from tokt.labels.page.state.session import open_session

    one, other = _dive(tmp_path / "1" / "dive", 1), _dive(tmp_path / "2" / "dive", 2)
    open_session(open_mission(one), tmp_path / "w", Grid(2, 2, 40), "anna", "1").close()
    with pytest.raises(ToktError, match="belong to the frames"):
        open_session(open_mission(other), tmp_path / "w", Grid(2, 2, 40), "anna", "1")
    LabelStore(tmp_path / "w" / "labels.db").close()  # and it is not left locked
