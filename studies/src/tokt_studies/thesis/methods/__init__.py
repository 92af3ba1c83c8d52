"""The methods that the exhibits compare, run over frames and pictures."""
