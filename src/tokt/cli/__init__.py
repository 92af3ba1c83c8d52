"""The command line that joins the parts; each command imports what it needs when it runs."""

from .app import app, main

__all__ = ["app", "main"]
