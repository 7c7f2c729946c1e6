"""Adaptive smoothing with switches: the method is in adaptive.py, the model that it makes in model.py."""
