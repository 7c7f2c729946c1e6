"""Kernel-based regression: the method, and kernel, record, likelihood and search behind it."""
