"""A run put together from its description: `tokt.run`."""
