"""`tokt run --watchdog` on a stream, which the command refuses, as a stream may wait for ever.

The soak's never does: a frame comes within two seconds, as from a camera. All else is as it is.
"""

from tokt.cli import main
from tokt.inference.sources import stream

if __name__ == "__main__":
    stream.is_stream_source = lambda text: False  # in the watchdog alone
    main()
