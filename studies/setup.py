"""The pin of tokt-studies to tokt of the same version."""

import tomllib
from pathlib import Path

from setuptools import setup
from setuptools_scm import get_version

settings = tomllib.loads(Path(__file__).with_name("pyproject.toml").read_text("utf-8"))
version = get_version(**settings["tool"]["setuptools_scm"], relative_to=__file__)
setup(install_requires=[f"tokt[demo]=={version}"])
