"""The command line that joins the parts; each command imports what it needs when it runs."""

from .interrupts import interrupt_ends

with interrupt_ends():
    from .app import main

__all__ = ["main"]
