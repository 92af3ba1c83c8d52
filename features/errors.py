"""The one error type that a user's own input can cause."""


class ToktError(Exception):
    """Something the user gave cannot be used; the message is one line, in the user's words.

    The command line prints it as ``tokt: error: MESSAGE`` and exits with code 2. Programming
    mistakes raise the usual built-in exceptions instead, and do show a traceback.
    """


class FrameError(ToktError):
    """One frame cannot be read. A mission goes on without it; the runtime calls it unknown."""
