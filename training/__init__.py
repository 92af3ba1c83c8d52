"""Dataset versions, honest cross-validation, training with MLflow, evaluation and comparison."""
