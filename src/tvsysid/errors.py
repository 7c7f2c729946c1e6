"""What goes wrong at the border: one error for what cannot be used, one warning for what is doubtful."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used: says what came, what was expected and what to do."""


class DataQualityWarning(UserWarning):
    """Input that is legal, but whose result deserves doubt; kept in the model's diagnostics too."""
