"""Fit both pathways jointly: cascade.py holds the method and its model."""
