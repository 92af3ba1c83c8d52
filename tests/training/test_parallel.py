"""Tasks on several processes; a real dask cluster is in tests/process/test_dask.py."""

import math
import socket
import time

import pytest

from tests.calls import refuses
from tokt.features.common.errors import ToktError
from tokt.training import parallel
from tokt.training.parallel import mapped


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_in_order_from_few_tasks_at_a_time(jobs):
    taken = 0

    def numbers():
        nonlocal taken
        for number in range(1000):
            taken += 1
            yield number

    results = mapped(math.sqrt, numbers(), jobs)
    assert [next(results) for _ in range(3)] == [0.0, 1.0, math.sqrt(2)]
    time.sleep(0.5)  # nobody takes results: no more tasks may be taken
    assert taken <= 128 * jobs
    assert list(results) == [math.sqrt(number) for number in range(3, 1000)]


def test_what_a_task_raises_is_raised():
    results = mapped(math.sqrt, [1.0, -1.0], jobs=2)
    with pytest.raises(ValueError, match="math domain error"):
        list(results)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "no-port", "bad://127.0.0.1:1"])
def test_a_scheduler_that_is_not_there_is_said_in_seconds(address):
    assert parallel._REACHED_S < 10
    with pytest.raises(ToktError, match=rf"the dask scheduler {address} cannot be reached"):
        list(mapped(math.sqrt, [1.0], dask=address))


def test_a_port_of_something_else_is_no_scheduler(monkeypatch):
    monkeypatch.setattr(parallel, "_REACHED_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        refuses("cannot be reached", list, mapped(math.sqrt, [1.0], dask=address))
