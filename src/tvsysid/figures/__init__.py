"""Figures: each function takes what it draws and returns a figure.

None computes more than means and spreads.

A ``title`` stands above all of a figure.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
