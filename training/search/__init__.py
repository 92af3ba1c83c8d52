"""Search for the best extractor of a dataset, by a rule that is written down before."""
