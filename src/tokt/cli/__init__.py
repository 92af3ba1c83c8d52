"""The command line that joins the parts; each command imports what it needs when it runs."""

import _signal  # type: ignore[import-not-found]  # built in: `signal` would look for others


class InterruptEnds:
    """Context in which Ctrl-C ends the process at once, in silence; other handlers are kept."""

    def __enter__(self) -> None:
        self._before = _signal.getsignal(_signal.SIGINT)
        try:
            if self._before in (_signal.default_int_handler, interrupt):
                _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
        except ValueError:  # not the main thread
            self._before = None

    def __exit__(self, *_error: object) -> None:
        if self._before and _signal.getsignal(_signal.SIGINT) == _signal.SIG_DFL:
            _signal.signal(_signal.SIGINT, self._before)


interrupts: list[int] = []
"""Each Ctrl-C that has come: a library may turn it into an error of its own."""


def interrupt(*_signal_and_frame: object) -> None:
    """Raise KeyboardInterrupt, as Python's own handler of Ctrl-C does.

    Libraries log no more of what it cuts off, such as a cursor of a database.
    """
    interrupts.append(_signal.SIGINT)
    if "logging" in sys.modules:
        sys.modules["logging"].disable()
    raise KeyboardInterrupt


def _end_late(signals: int) -> None:
    """End the process soon after Ctrl-C: a library may drop the exception, or wait for its work."""
    while (
        os.read(signals, 1)[0] != _signal.SIGINT
        or _signal.getsignal(_signal.SIGINT) is not interrupt
    ):
        pass  # a signal that a command handles itself
    time.sleep(_PUT_AWAY_S)
    os._exit(130)


def _raise_again(dropped: "sys.UnraisableHookArgs") -> None:
    """Raise a KeyboardInterrupt again that came in a destructor, where Python drops it."""
    if not issubclass(dropped.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)
    elif not sys.is_finalizing():
        _thread.start_new_thread(_thread.interrupt_main, ())  # after this, not within it


with InterruptEnds():
    import _thread
    import gc
    import os
    import sys
    import time

    gc.disable()  # what is imported stays: to look for garbage in it takes time
    from . import app

    gc.freeze()
    gc.enable()

_PUT_AWAY_S = 2.0  # how long a command may take to put away what it began


def main() -> None:
    """Run the command line as a program, which Ctrl-C ends within some seconds."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, interrupt)
    sys.unraisablehook = _raise_again
    if sys.platform != "win32":  # where a pipe blocks
        signals, written = os.pipe()
        os.set_blocking(written, False)
        _signal.set_wakeup_fd(written)  # at once, whatever the main thread computes
        _thread.start_new_thread(_end_late, (signals,))
    app.main()
