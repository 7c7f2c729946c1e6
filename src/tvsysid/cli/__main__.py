"""Run ``python -m tvsysid.cli``."""

from tvsysid.cli.app import main

main()
