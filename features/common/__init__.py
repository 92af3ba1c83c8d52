"""Shared basics: atomic files, locks, errors, hashes, facts of the machine."""
