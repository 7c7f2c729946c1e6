"""A study, an experiment, an identification or a diagnosis as one page: what was done, and what came out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
