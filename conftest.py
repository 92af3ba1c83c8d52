"""Fixtures and tiers for the tests of tokt (`tests`) and of its studies (`studies/tests`)."""

pytest_plugins = ["tests.fixtures"]
