"""Fetch Python for browsers for the page ``browser.md``.

This is Pyodide, NumPy and SciPy as WebAssembly (30 MB).

``python docs/get_pyodide.py`` downloads a wheel (106 MB) that contains these files and keeps only
them. ``python docs/get_pyodide.py FOLDER`` copies them from an unpacked Pyodide distribution.
Either way, each file must have the checksum below. The checksums of NumPy and SciPy come from
Pyodide's list of packages, those of the other files from Pyodide's package on npm.
"""

import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

CARRIER, WITHIN = "open-webui==0.12.4", "open_webui/frontend/pyodide/"  # has Pyodide 314.0.3
BROWSER = "cp314-cp314-pyemscripten_2026_0_wasm32.whl"
LIST = "pyodide-lock.json"  # says from where packages are loaded, so that it is checked as they are
FILES = {
    LIST: "0f32bc9646759d653d2895f4c49a85bfaff0c31a822dfa9b04c97c4264d3fdd9",
    "pyodide.mjs": "5cfc46f5dcbaf2a16f26e2363f441873eb424762609cc03db00d6a2ace4d00e5",
    "pyodide.asm.mjs": "1a9775427ef6e8abaa7db88ece0515422d1886915ae5c9093776410c865dfd8d",
    "pyodide.asm.wasm": "e7f8fac36f8bf11085309cbc5c829b3ec3057c18bf1d73b05a6741612d63cdbf",
    "python_stdlib.zip": "444c770dfd75a32097fc0a7d5c1413fd3140601f49c3a1f2e9af0376fcd124b4",
    f"numpy-2.4.3-{BROWSER}": "0cad9c1b91f0082e4f959bc0e0bf5835a2efbba6ab3b1e9d1fe6e7e564cca98e",
    f"scipy-1.18.0-{BROWSER}": "4ef1569eac793bec84a92fa2eaf24eafb4529ff10c5ed87d1e335063f26142f3",
}
HERE = Path(__file__).parent / "static/pyodide"


def keep(read: Callable[[str], bytes], target: Path) -> None:
    """Write all files that ``read`` gives by name, if each is the one that is meant."""
    contents = {name: shortened(read(name)) if name == LIST else read(name) for name in FILES}
    for name, content in contents.items():
        if (found := hashlib.sha256(content).hexdigest()) != FILES[name]:
            raise SystemExit(
                f"{name}: its SHA-256 is {found}, expected {FILES[name]}: not the file of Pyodide "
                "314.0.3"
            )
    target.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        (target / name).write_bytes(content)


def shortened(listed: bytes) -> bytes:
    """List of packages with NumPy and SciPy alone."""
    whole = json.loads(listed)
    packages = {name: whole["packages"][name] for name in ("numpy", "scipy")}
    return json.dumps(whole | {"packages": packages}, indent=1).encode()


def fetch(target: Path) -> None:
    """Get the carrier's wheel and keep what is Pyodide's."""
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet"]
        # A source distribution would run its own code
        command = [*pip, "--only-binary", ":all:", "--dest", folder, CARRIER]
        subprocess.run(command, check=True)
        with ZipFile(next(Path(folder).glob("*.whl"))) as wheel:
            keep(lambda name: wheel.read(WITHIN + name), target)


if __name__ == "__main__":
    if sys.argv[1:]:
        keep(lambda name: (Path(sys.argv[1]) / name).read_bytes(), HERE)
    else:
        fetch(HERE)
    print(f"{sum(path.stat().st_size for path in HERE.iterdir()) / 1e6:.0f} MB in {HERE}")
