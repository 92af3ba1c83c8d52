"""Monitoring of a run: metrics, status line, drift, watchdog, reload of the model."""
