"""Labels of patches: taxonomy, records, the label store, file formats, agreement, and the page."""
