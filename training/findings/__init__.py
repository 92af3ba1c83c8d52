"""The page of findings: each with its best picture, and where it is along the track."""
