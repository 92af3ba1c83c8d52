"""``python -m tokt``."""

from .cli import main

main()
