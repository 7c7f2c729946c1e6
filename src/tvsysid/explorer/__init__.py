"""A page on which one sees what a setting does to stiffness, its band and the diagnosis, at once."""

from tvsysid.explorer.serving import Exploration, explore

__all__ = ["Exploration", "explore"]
