"""The commands about labels: label, labels, labels audit."""
