"""What people say about patches: taxonomy, label store and files, agreement, synthetic missions."""
