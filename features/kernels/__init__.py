"""The kernels that compute texture features: compiled, numpy, or the reference libraries."""
