"""The deploy store: a folder of bundles on the ship, the active one, and its history."""
