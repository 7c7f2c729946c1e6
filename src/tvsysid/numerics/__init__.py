"""Numerics on plain arrays: no recordings, ensembles or models here."""
