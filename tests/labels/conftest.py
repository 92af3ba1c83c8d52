import pytest

from tokt.labels.store.store import LabelStore


@pytest.fixture
def store(tmp_path):
    """An empty label store."""
    with LabelStore(tmp_path / "labels.db") as opened:
        yield opened
