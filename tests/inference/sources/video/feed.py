"""A program that writes pictures to standard output at a rate, as a camera gives them."""

import os
import sys
import time

from .pictures import i420
from .stamps import Stamps


def pace(rate: float):
    """Wait for each picture's turn; after a pause, from now on."""
    due = time.monotonic()
    while True:
        yield
        due += 1 / rate
        now = time.monotonic()
        if due < now - 1 / rate:
            due = now
        time.sleep(max(0.0, due - now))


def main() -> None:
    """Arguments: width, height, rate, first number, file of the stamps or '-'."""
    width, height, rate, number = (int(text) for text in sys.argv[1:5])
    stamps = None if sys.argv[5] == "-" else Stamps(sys.argv[5])
    # Not sys.stdout.buffer: with PYTHONUNBUFFERED that writes a part of a picture where the program
    # is stopped meanwhile, and all that follows is displaced.
    pictures = os.fdopen(sys.stdout.fileno(), "wb")
    try:
        for _ in pace(rate):
            picture = i420(number, (width, height)).data
            if stamps:
                stamps.note(number, time.monotonic())
            pictures.write(picture)
            pictures.flush()
            number += 1
    except (BrokenPipeError, KeyboardInterrupt):
        sys.stderr.close()


if __name__ == "__main__":
    main()
