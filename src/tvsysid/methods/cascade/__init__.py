"""Joint fit of both pathways: the method is in cascade.py, the model that it makes in result.py."""
