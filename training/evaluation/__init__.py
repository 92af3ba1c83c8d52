"""Figures of merit of patches and frames against labels."""
