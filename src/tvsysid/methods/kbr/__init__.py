"""Kernel-based regression: the method and its model are in kbr.py."""
