"""Local page that shows the effect of each setting on stiffness, its band and the diagnosis."""

from tvsysid.explorer.serving import Exploration, explore

__all__ = ["Exploration", "explore"]
