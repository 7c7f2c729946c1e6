"""Walk through the explorer by its keyboard in headless Chromium; README.md beside it says how.

    python -m tests.browser.explorer FOLDER

opens it with a simulated file of 150 s, and writes pictures of the page to the folder.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import tvsysid as tv

ROOT = Path(__file__).parents[2]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def main(folder: str) -> int:
    """Exit code of the walk; 0, too, where there is no Chromium or no Node.js."""
    browser, node = next(filter(None, map(shutil.which, BROWSERS)), None), shutil.which("node")
    if browser is None or node is None:
        print("skipped: there is no Chromium, or no Node.js")
        return 0
    joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    recording = joint.simulate(
        150, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1, rate=1000
    ).recording
    pictures = Path(folder).resolve()
    pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        os.chdir(temporary)  # its name is no part of what the page shows
        np.savez("ankle.npz", pos=recording.angle, tq=-recording.torque)
        running = tv.explore("ankle.npz")
        walk = [
            node,
            Path(__file__).with_suffix(".mjs"),
            browser,
            running.url,
            "pos",
            "tq",
            pictures,
        ]
        return subprocess.run(walk, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
