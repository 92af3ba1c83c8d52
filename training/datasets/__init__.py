"""Dataset versions, the missions they are built from, splits, and tables of features."""
