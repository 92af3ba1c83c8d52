"""The frames in which somebody gave a label: what the page's filter by class asks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture(scope="module")
def server(page_server: Callable[..., Any]) -> Any:
    return page_server("--annotator", "anna")


def test_frames_with_a_class_are_those_of_one_person_as_they_are_now(server: Any) -> None:
    def found(who: str, label: str, **more: Any) -> list[int]:
        query = {"who": who, "class": label, **more}
        frames = server.get("/api/frames_with", **query)["cameras"]["left"]
        assert isinstance(frames, list)
        return frames

    assert found("anna", "sand") == []
    server.paint("one", 9, [3, 4], "sand")
    server.paint("two", 2, [0], "sand")
    server.paint("three", 2, [1], "reef")
    server.paint("four", 5, [0], "sand", who="ben")
    assert found("anna", "sand") == found("anna", "sand", blind=1) == [2, 9]
    assert (found("anna", "reef"), found("ben", "sand"), found("ben", "reef")) == ([2], [5], [])
    assert found("anna", "no such class") == found("nobody", "sand") == []
    server.paint("five", 9, [3], None, base="sand")
    assert found("anna", "sand") == [2, 9]
    server.paint("six", 9, [4], "reef", base="sand")
    assert found("anna", "sand") == [2] and found("anna", "reef") == [2, 9]
    assert server.request("GET", "/api/frames_with?who=anna").status == 400
