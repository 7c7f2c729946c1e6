"""Kernel-based regression.

Read it in this order:

- ``kernel.py``: the prior, which says how smoothly stiffness may change. Another kernel goes here.
- ``record.py``: the data, as spectra and their sums of products.
- ``kbr.py``: the method, which fits weights and noise variance for a given prior, and its model.
- ``search.py``: how ``tuned`` chooses these settings by maximum marginal likelihood.
"""
