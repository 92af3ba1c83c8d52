"""Share the rows of one frame among threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    # Imported only where threads are asked for: it is 4 ms of a start.
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(threads, thread_name_prefix="tokt-kernels")


if hasattr(os, "register_at_fork"):
    # A forked child has the pool but not its threads: it would wait for ever.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def over_rows(work: Callable[[int, int], None], rows: int, threads: int) -> None:
    """Call ``work(first, last)`` so that all rows are done, in equal parts, one a thread.

    Parameters
    ----------
    work : callable
        Writes the results of rows first..last where they belong; whatever it raises is raised
        here.
    rows, threads : int
        At least 1 each.
    """
    threads = min(threads, rows)
    if threads == 1:
        work(0, rows)
        return
    ends = [rows * part // threads for part in range(threads + 1)]
    parts = [_pool(threads).submit(work, *ends[part : part + 2]) for part in range(threads)]
    for part in parts:
        part.result()
