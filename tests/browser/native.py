"""Run blocks of code as the page does, but without a browser, and print the results.

The blocks are a JSON list on standard input.
"""

import importlib.util
import json
import sys
from pathlib import Path

if __name__ == "__main__":
    spec = importlib.util.spec_from_file_location(
        "run", Path(__file__).parents[2] / "docs/static/browser/run.py"
    )
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    print(json.dumps([json.loads(page.run(code)) for code in json.load(sys.stdin)]))
