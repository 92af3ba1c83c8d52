"""The label store: everything anybody said about patches, in one SQLite file that only grows."""
