"""Work beside the page ends when it is told to, at whatever moment that is."""

import threading

from tokt.labels.page.background import Background

HANG_S = 30.0  # only a thread that hangs takes so long


def test_an_end_just_before_the_next_step_is_not_missed():
    """`close` comes after the thread has looked whether it is to end, and before it waits."""

    class Wake(threading.Event):
        def clear(self):
            if not work._ended.is_set():
                work._ended.set()
                self.set()
            super().clear()

    work = Background("work", lambda: False)
    work._wake = Wake()
    work.start()
    work._thread.join(HANG_S)
    alive = work._thread.is_alive()
    work._wake.set()
    assert not alive
