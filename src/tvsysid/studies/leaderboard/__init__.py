"""A leaderboard that others can enter: frozen scenarios, one score, and a page."""

from tvsysid.studies.leaderboard.page import FILES, write_leaderboard
from tvsysid.studies.leaderboard.standing import standings
from tvsysid.studies.leaderboard.version import SECRET, SEED, VERSION, study_of

__all__ = ["FILES", "SECRET", "SEED", "VERSION", "standings", "study_of", "write_leaderboard"]
