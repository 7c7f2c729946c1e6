"""Kernel-based regression.

Read it in this order:

- ``kernel.py``: the prior, which says how smoothly stiffness may change. Another kernel goes here.
- ``record.py``: the data, as spectra and their sums of products.
- ``search.py``: how the prior is chosen by maximum marginal likelihood.
- ``kbr.py``: the method, its settings, its fit for a given prior and its model.
"""
