"""Work beside the page ends when it is told to, at whatever moment that is."""

from tokt.labels.page.background import Background


def test_a_work_that_waits_is_woken_and_ends():
    for _ in range(100):  # the end comes before, between or after its looks whether to go on
        work = Background("work", lambda: False)
        work.start()
        work.wake()
        work.close()
