"""Labels of a small mission, and files gone wrong."""

from __future__ import annotations

from hypothesis import strategies as st

from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord, utc_text
from tokt.labels.taxonomy import Taxonomy

TAXONOMY = Taxonomy.load()
FRAMES = (3, 7, 20)
HEIGHT, WIDTH = 137, 181
GRIDS = (Grid(), Grid(3, 4, 120), Grid(2, 2, None))
TIME = "2016-04-20T10:00:00Z"


def said(label: str = "reef", row: int = 0, col: int = 0, **more) -> LabelRecord:
    """A label of the mission."""
    values = {"camera": "left", "frame": 3, "grid": Grid(), "annotator": "ann", "time": TIME}
    values.update(more)
    return LabelRecord(mission="dive", row=row, col=col, label=label, **values)


# Names that a spreadsheet, a CSV reader or DIVE would take for something else.
_names = st.sampled_from(
    ["7", "007", "1e5", "true", "nan", '"q"', "a,b", "0x1f", "Åse Ø.", "(atr) x"]
)
_names |= st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=8)
_moments = st.datetimes(timezones=st.timezones()).filter(lambda t: 2 < t.year < 9998)


@st.composite
def _records(draw: st.DrawFn, cameras: tuple[str, ...], grids: tuple[Grid, ...]) -> LabelRecord:
    grid = draw(st.sampled_from(grids))
    source = draw(st.sampled_from(["human", "human", "model", "settled"]))
    return LabelRecord(
        "dive",
        draw(st.sampled_from(cameras)),
        draw(st.sampled_from(FRAMES)),
        grid,
        draw(st.integers(0, grid.rows - 1)),
        draw(st.integers(0, grid.cols - 1)),
        draw(st.sampled_from([*TAXONOMY.names, "unsure"])),
        draw(_names),
        utc_text(draw(_moments).isoformat()),
        source,
        draw(_names) if source == "model" else draw(st.none() | _names),
    )


def some_records(
    cameras: tuple[str, ...] = ("left", "right"), grids: tuple[Grid, ...] = GRIDS
) -> st.SearchStrategy[list[LabelRecord]]:
    """Labels in force: one a patch and annotator, one settlement and any suggestions a patch."""
    return st.lists(
        _records(cameras, grids),
        min_size=1,
        max_size=12,
        unique_by=lambda r: (r.cell, "" if r.source == "settled" else r.annotator, r.source),
    )


@st.composite
def damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """A file that was cut, or had some bytes changed, put in or taken out."""
    if draw(st.booleans()):
        return data[: draw(st.integers(0, len(data)))]
    found = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(found)))
        found[at : at + draw(st.integers(0, 3))] = draw(
            st.binary(max_size=2)
            | st.sampled_from(
                [b'"', b",", b"\n", b"-", b"NaN", b"null", b"9" * 400, b"1e999", b"[]"]
            )
        )
    return bytes(found)


ODD_VALUES = st.sampled_from(
    [
        None,
        True,
        -1,
        0,
        3.5,
        10**30,
        float("nan"),
        float("inf"),
        "",
        "x",
        "3",
        "\ud800",
        [],
        [1],
        {},
    ]
)


@st.composite
def with_odd_values(draw: st.DrawFn, value: object) -> object:
    """A JSON value some of whose parts are another kind of thing."""
    places = list(_places(value))
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from(places))
        holder[key] = draw(ODD_VALUES)
    return value


def _places(value: object):
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, part in items:
        yield value, key
        if isinstance(part, dict | list):
            yield from _places(part)
