"""Write a study, an experiment, an identification or a diagnosis as one page."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
