"""What people say about patches: taxonomy, label store, label files, agreement, synthetic missions."""
