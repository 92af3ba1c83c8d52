from hypothesis import given
from hypothesis import strategies as st

from tokt.features.common.spreadsheet import guarded, unguarded

SIGNS = st.sampled_from("=+-@'\t\r\nab1.")


@given(st.text(SIGNS) | st.text())
def test_a_cell_comes_back_and_begins_no_formula(text):
    cell = guarded(text)
    assert unguarded(cell) == text
    assert cell == text or cell[0] == "'"


def test_numbers_stay_numbers_and_names_do_not_become_formulas():
    assert [guarded(text) for text in ("-1.50", "+3", "=1+1", "@x", "-dive", "a=b")] == [
        *("-1.50", "+3", "'=1+1", "'@x", "'-dive", "a=b")
    ]
