"""Recordings and models from and to files.

Everything is imported when it is first used, so that the process that reads files starts
quickly; ``__init__.pyi`` beside this file lists the names.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
