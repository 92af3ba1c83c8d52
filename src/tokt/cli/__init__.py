"""The command line that joins the parts; each command imports what it needs when it runs."""

import gc

from .interrupts import interrupt_ends

gc.disable()  # what is imported stays: to look for garbage in it takes time
with interrupt_ends():
    from .app import main
gc.freeze()
gc.enable()

__all__ = ["main"]
