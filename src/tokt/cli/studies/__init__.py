"""The commands that measure or try out tokt: bench, demo, reproduce, simulate."""
