"""Ctrl-C at moments that Python makes nothing good of: imports, destructors, threads, the end."""

import signal
import sys

import pytest

from tests.calls import run_python
from tests.inference.test_faults import hold_row

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to a single process"),
]

# Ctrl-C at the n-th module that tokt's own code asks for; what Python and its launcher ask for
# before is not counted, as no line of tokt has run.
AT_IMPORT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
left = [int(sys.argv.pop())]
def hook(event, arguments):
    if event != "import" or left[0] <= 0:
        return
    frame = sys._getframe(1)
    while frame and not str(frame.f_globals.get("__name__")).startswith("tokt"):
        frame = frame.f_back
    if frame:
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), signal.SIGINT)
sys.addaudithook(hook)
"""
AS_PROGRAM = "from tokt.cli import main; main()"
AS_MODULE = "import runpy; runpy.run_module('tokt', run_name='__main__', alter_sys=True)"


@pytest.mark.parametrize("start", [AS_PROGRAM, AS_MODULE], ids=["program", "module"])
def test_at_any_import(start):
    codes = []
    for number in [*range(1, 13), 20, 40, 80, 160]:
        ran = run_python("-c", AT_IMPORT + start, "store", "none", number)
        assert "Traceback" not in ran.stderr and "Interrupt" not in ran.stderr, ran.stderr
        codes.append(ran.returncode)
    assert set(codes) <= {-signal.SIGINT, 130, 2} and codes.count(2) < 5, codes
    hold_row(
        "Ctrl-C while tokt starts",
        "ends at once by the signal, nothing printed, from the first line of tokt on",
        "nothing",
    )


HANDLERS = """
import importlib, signal, sys, threading
def own(*_): pass
for handler in (signal.default_int_handler, signal.SIG_IGN, signal.SIG_DFL, own):
    for name in [name for name in sys.modules if name.startswith("tokt")]:
        del sys.modules[name]
    signal.signal(signal.SIGINT, handler)
    hook = sys.unraisablehook
    import tokt, tokt.cli
    assert signal.getsignal(signal.SIGINT) == handler, handler
    assert sys.unraisablehook is hook
for name in [name for name in sys.modules if name.startswith("tokt")]:
    del sys.modules[name]
thread = threading.Thread(target=importlib.import_module, args=["tokt.cli"])
thread.start()
thread.join()
assert "tokt.cli.app" in sys.modules
"""


def test_who_imports_tokt_keeps_signals():
    ran = run_python("-c", HANDLERS)
    assert (ran.returncode, ran.stderr) == (0, "")


# A command that does something odd with Ctrl-C.
ODD = """
import atexit, os, signal, sys, threading, time
from tokt.cli import app, main
signal.signal(signal.SIGINT, signal.default_int_handler)
def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):
        pass
class Destroyed:
    def __del__(self):
        interrupt()
def destructor():
    Destroyed()
    while True:
        pass
def dropped():
    try:
        interrupt()
    except KeyboardInterrupt:
        threading.Event().wait()
def waits():
    threading.Thread(target=threading.Event().wait).start()
    interrupt()
def ends():
    atexit.register(interrupt)
def handles():
    signal.signal(signal.SIGINT, lambda *_: None)
    interrupt()
    time.sleep(3)
odd = globals()[sys.argv[1]]
app._app_for = lambda words: lambda standalone_mode: odd()
main()
"""
ODD_ENDS = {"destructor": 130, "dropped": 130, "waits": 130, "ends": 0, "handles": 0}


@pytest.mark.parametrize("name", ODD_ENDS)
def test_ends_though_the_exception_is_lost(name):
    ran = run_python("-c", ODD, name)
    assert (ran.returncode, ran.stdout, ran.stderr) == (ODD_ENDS[name], "", "")
    hold_row(
        "Ctrl-C whose exception a library drops, or whose work goes on",
        "ends within 3 s, code 130, nothing printed",
        "nothing",
    )
