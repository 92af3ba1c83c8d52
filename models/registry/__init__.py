"""The model registry (MLflow), and the way from a registered version to a bundle."""
