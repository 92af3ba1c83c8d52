"""The commands around a run: run, listen, replay, shadow."""
