"""Two pathways of a joint.

``cascade.py`` fits both jointly, by ``search.py``, ``fit.py`` and ``columns.py``.
``alternating.py`` fits each in turn. ``reflex_test.py`` tests for a reflex.
"""
