"""The demo: the whole chain in one run, ending with a report."""
