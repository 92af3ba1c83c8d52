"""The packages, found in their folders; everything else is in pyproject.toml."""

from setuptools import find_packages, setup

TOP_LEVEL = ("features", "labels", "training", "models", "inference")

setup(
    packages=[
        *find_packages("src"),
        *(f"tokt.{part}" for part in TOP_LEVEL),
        *(f"tokt.{part}.{name}" for part in TOP_LEVEL for name in find_packages(part)),
    ]
)
