"""Files of rows: features in place of pictures, to half a step, and none but those wanted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tests.calls import refuses
from tokt.training.datasets.frame_rows import (
    FrameRows,
    Scale,
    file_name,
    read_frame_rows,
    rows_file,
)

SPEC, CHANGES = {"name": "lbp", "version": 1}, "random_2"
DIGESTS = ["ab" * 32, "cd" * 32]


def frames(dim=5, patches=4):
    rng = np.random.default_rng(3)
    return [
        FrameRows(
            digest,
            rng.normal(7, 2, (patches, dim)),
            rng.normal(7, 2, (3, dim)),
            np.array([1, 1, 3]),
        )
        for digest in DIGESTS
    ]


@pytest.fixture
def stored(tmp_path):
    data = rows_file(frames(), SPEC, CHANGES)
    path = tmp_path / file_name(data)
    path.write_bytes(data)
    return path


def test_what_is_read_is_what_was_written_to_half_a_step(stored):
    written = frames()
    of = {name: np.concatenate([getattr(one, name) for one in written])
          for name in ("values", "changed")}  # fmt: skip
    step = {name: Scale.of(table).step for name, table in of.items()}
    for one in written:
        found = read_frame_rows(stored, one.digest, SPEC, CHANGES)
        # But what lies more than three standard deviations out.
        for name in of:
            off = np.abs(getattr(found, name) - getattr(one, name))
            assert (off <= 0.51 * step[name]).mean() > 0.95
        assert found.cells.tolist() == [1, 1, 3]
        again = read_frame_rows(stored, one.digest, SPEC)
        assert (again.values == found.values).all()
    assert rows_file(written, SPEC, CHANGES) == stored.read_bytes()


@given(
    arrays.arrays(np.float64, st.tuples(st.integers(2, 9), st.integers(1, 7)),
                  elements=st.floats(-1e6, 1e6, width=32)),
)  # fmt: skip
def test_a_table_stays_within_half_a_step_of_itself(table):
    """What lies within three standard deviations: of so few rows all does."""
    scale = Scale.of(table)
    packed = scale.packed(table)
    assert packed.shape == (len(table), (table.shape[1] + 1) // 2)
    found = scale.unpacked(packed)
    assert (np.abs(found - table) <= scale.step * (0.5 + 1e-6) + 1e-6 * np.abs(table).max()).all()
    if (scale.step > 1e-5 * np.abs(table).max()).all():  # not below what 32 bits tell apart
        assert (scale.packed(found) == packed).all()


def test_what_is_not_wanted_is_refused(stored, tmp_path):
    one = DIGESTS[0]
    other = "hold features of another extractor, and no pictures"
    refuses(other, read_frame_rows, stored, one, {**SPEC, "version": 2})
    refuses(other, read_frame_rows, stored, one, SPEC, "random_9")
    refuses("are damaged", read_frame_rows, stored, "ef" * 32, SPEC)
    refuses("No such file", read_frame_rows, tmp_path / "none.rows", one, SPEC)
    stored.write_bytes(stored.read_bytes()[:-1] + b"x")
    refuses("have changed since the dataset was built", read_frame_rows, stored, one, SPEC)


def test_a_newer_format_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr("tokt.training.datasets.frame_rows.FORMAT_VERSION", 2)
    data = rows_file(frames(), SPEC, CHANGES)
    path = tmp_path / file_name(data)
    path.write_bytes(data)
    monkeypatch.undo()
    refuses("newer", read_frame_rows, path, DIGESTS[0], SPEC)
