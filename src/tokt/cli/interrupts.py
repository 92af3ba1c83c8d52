"""Ctrl-C while a command starts; a module of its own, as it is there before all others."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interrupt_ends() -> Iterator[None]:
    """Let Ctrl-C end the process at once and without a word, while there is nothing to put away.

    Whoever handles it within the block keeps it.
    """
    known = threading.current_thread() is threading.main_thread()
    if not known or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
            signal.signal(signal.SIGINT, signal.default_int_handler)
