"""Run one function over many tasks: here, on several processes, or on the workers of a cluster.

Results do not depend on where: they come in the order of the tasks, and every task runs with one
thread of linear algebra, so that sums are added up in the same order. With a dask scheduler the
workers are taken to see the same files under the same paths as this process (a shared file
system), and to run the same tokt; a worker that runs another one is refused.
"""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

import joblib
from threadpoolctl import ThreadpoolController

from tokt import __version__
from tokt.features.common.errors import ToktError
from tokt.features.kernels.dispatch import KERNELS

if TYPE_CHECKING:
    from distributed import Client, Future

Task = TypeVar("Task")
Result = TypeVar("Result")

_TASKS_A_PROCESS = 128  # in memory; at the end of so many the processes wait for the slowest
_REACHED_S = 5.0
_WORKER_S = 10.0
_BATCHES_A_THREAD = 4  # in flight: enough to hide the way to a worker, few enough to hold
_BATCH_S = 0.2  # a batch worth the way, which is some 10 ms
_MAX_BATCH = 64
_LIBRARIES = ("numpy", "opencv-python-headless", "scikit-learn", "scipy")


def mapped(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    jobs: int = -1,
    dask: str | None = None,
) -> Iterator[Result]:
    """``map(function, tasks)`` on several processes: results in the order of the tasks.

    Tasks are taken from `tasks` as they are needed, at most 128 a process ahead of the results, so
    that millions of them need not be in memory. What a task raises is raised here.

    The function takes one task. It is of a module (no lambda, no nested function) and the tasks are
    such that both can be pickled; what it returns depends on its task alone. Paths in tasks must
    hold on every worker.

    `jobs` are processes on this machine: -1 for one a core, 1 for this process alone. Instead of
    them `dask` is the address of a scheduler, as ``tcp://10.0.0.5:8786`` (extra ``cluster``).

    Raises ToktError if the scheduler cannot be reached within seconds, has no worker, is lost, or a
    worker runs another tokt.
    """
    if dask is not None:
        return _on_cluster(function, tasks, dask)
    if jobs == 0:
        raise ToktError("jobs: a number of processes, or -1 for one a core; not 0")
    processes = joblib.effective_n_jobs(jobs)
    if processes == 1:
        return _here(function, tasks)
    return _on_processes(function, tasks, processes)


def _here(function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
    controller = ThreadpoolController()
    for task in tasks:
        with controller.limit(limits=1):
            result = function(task)
        yield result


def _on_processes(
    function: Callable[[Task], Result], tasks: Iterable[Task], processes: int
) -> Iterator[Result]:
    work, rest = joblib.delayed(_in_worker), iter(tasks)
    with joblib.Parallel(n_jobs=processes, return_as="generator") as run:
        # joblib's generator goes on taking tasks while nobody takes its results, and holds those.
        while share := list(islice(rest, _TASKS_A_PROCESS * processes)):
            yield from run(work(function, task) for task in share)


@lru_cache(maxsize=64)
def _one_thread(function: Callable[..., Any]) -> None:
    """Hold this worker to one thread of linear algebra, once `function` has loaded its libraries.

    For good: threads of a dask worker share the setting, and must not undo each other's.
    """
    ThreadpoolController().limit(limits=1)


def _in_worker(function: Callable[[Task], Result], task: Task) -> Result:
    _one_thread(function)
    return function(task)


@lru_cache(maxsize=1)
def software() -> dict[str, str]:
    """Versions of what has to be the same everywhere for results to be the same."""
    libraries = {name: version(name) for name in _LIBRARIES}
    return {"tokt": __version__, "kernels": KERNELS.name, **libraries}


def _in_cluster(
    function: Callable[[Task], Result], expected: dict[str, str], tasks: list[Task]
) -> tuple[list[Result], float]:
    """Results of a batch of tasks and the seconds they took."""
    found = software()
    if found != expected:
        other = [name for name, value in expected.items() if found[name] != value]
        raise ToktError(
            f"a dask worker on {socket.gethostname()} has another version of "
            + ", ".join(f"{name} ({found[name]}, here {expected[name]})" for name in other)
        )
    _one_thread(function)
    began = time.monotonic()
    return [function(task) for task in tasks], time.monotonic() - began


def _client(address: str) -> Client:
    from distributed import Client
    from distributed.comm import get_address_host_port

    try:
        # A scheduler greets first. dask's own attempt would wait for ever for a greeting.
        with socket.create_connection(get_address_host_port(address), _REACHED_S) as greeted:
            if not address.startswith("tls:"):
                greeted.recv(1)
        return Client(address, timeout=_REACHED_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ToktError(f"the dask scheduler {address} cannot be reached: {error}") from error


def _on_cluster(
    function: Callable[[Task], Result], tasks: Iterable[Task], address: str
) -> Iterator[Result]:
    from distributed import CancelledError
    from distributed.comm import CommClosedError
    from distributed.scheduler import KilledWorker

    with _client(address) as client:
        try:
            client.wait_for_workers(1, timeout=_WORKER_S)
            threads = sum(client.nthreads().values())
            work = partial(_in_cluster, function, software())
            yield from _in_order(client, work, tasks, _BATCHES_A_THREAD * max(1, threads))
        except TimeoutError as error:
            raise ToktError(f"the dask scheduler {address} has no worker") from error
        except KilledWorker as error:
            raise ToktError(
                f"the dask workers of {address} died one after the other of the same task; "
                "have they too little memory?"
            ) from error
        except (CommClosedError, CancelledError) as error:
            raise ToktError(f"the dask scheduler {address} was lost during the work") from error
        except ModuleNotFoundError as error:
            raise ToktError(
                f"a dask worker of {address} has no {error.name}: install "
                "the extras 'train' and 'cluster' there"
            ) from error


def _in_order(
    client: Client,
    work: Callable[[list[Task]], tuple[list[Result], float]],
    tasks: Iterable[Task],
    ahead: int,
) -> Iterator[Result]:
    """Results of all tasks, from batches that grow while they take little time."""
    waiting: deque[Future[tuple[list[Result], float]]] = deque()
    rest, size = iter(tasks), 1
    try:
        while True:
            while len(waiting) < ahead and (batch := list(islice(rest, size))):
                # `pure` would have dask hash every task, and give one result for equal ones.
                waiting.append(client.submit(work, batch, pure=False))
            if not waiting:
                return
            results, seconds = waiting.popleft().result()
            if seconds < _BATCH_S / 2:
                size = min(2 * size, _MAX_BATCH)
            yield from results
    finally:
        for future in waiting:
            future.cancel()
