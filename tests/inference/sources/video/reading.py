"""A reader of an address on a thread of the tests' process: what it shows, and why it ends."""

import threading
from contextlib import contextmanager

from tests.waiting import until
from tokt.inference.sources.video.address import VideoAddress
from tokt.inference.sources.video.newest import NewestReading, StreamLostError


class Newest(NewestReading):
    """Without the alarm that would end the tests' process."""

    def alive(self):
        pass

    def next(self):
        return until(lambda: self.take(0.1))[1]


@contextmanager
def reading(read, url):
    """A reader's newest reading, and the words with which its stream was lost."""
    newest, words = Newest(), []

    def work():
        try:
            read(VideoAddress.parse(url), newest)
        except StreamLostError as error:
            words.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield newest, words
    finally:
        newest.stopped.set()
        thread.join()


def words_of(read, url):
    """Why an address cannot be read."""
    with reading(read, url) as (_, words):
        until(lambda: words)
    return words[0]
