"""What every method must do, as checks that anybody's method can be put to."""

from tvsysid.check.rules import Check, check_method

__all__ = ["Check", "check_method"]
