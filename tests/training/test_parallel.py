"""Tasks on several processes; a real dask cluster is in tests/process/test_dask.py."""

import math
import time

import pytest

from tokt.features.common.errors import ToktError
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
    time.sleep(0.1)  # nobody takes results: no more tasks may be taken
    assert taken <= 128 * jobs
    assert list(results) == [math.sqrt(number) for number in range(3, 1000)]


def test_what_a_task_raises_is_raised():
    results = mapped(math.sqrt, [1.0, -1.0], jobs=2)
    with pytest.raises(ValueError, match="math domain error"):
        list(results)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "no-port"])
def test_a_scheduler_that_is_not_there_is_said(address):
    with pytest.raises(ToktError, match=rf"the dask scheduler {address} cannot be reached"):
        list(mapped(math.sqrt, [1.0], dask=address))
