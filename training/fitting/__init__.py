"""Cross-validation, the operating point, and the fit of one model version."""
