"""Ed25519 keys: those that sign bundles, and those that a store trusts."""
