"""Fit both pathways jointly: cascade.py holds the method, result.py holds its model."""
