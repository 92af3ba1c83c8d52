"""The linear model, the bundle that ships it, the store that activates it, and the registry."""
