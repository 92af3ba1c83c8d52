"""Tests of the documentation, which shows and runs the commands of tokt-studies too."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("tokt_studies") else ["*"]
