"""Adaptive smoothing with switches: the method is in adaptive.py, its model in model.py."""
