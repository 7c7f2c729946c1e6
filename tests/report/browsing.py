"""A page in a real browser, in a frame as wide as a phone."""

import json
import re

FRAME = """<!DOCTYPE html>
<html><head><meta charset="utf-8"></head><body><pre id="seen"></pre><script>
const frame = document.createElement("iframe");
frame.width = 360; frame.height = 800; frame.style.border = 0;
frame.srcdoc = PAGE;
const seen = { broken: [] };
frame.onload = async () => {
  const view = frame.contentWindow, page = view.document;
  CHECKS
  seen.broken = view.broken;
  document.getElementById("seen").textContent = JSON.stringify(seen);
};
document.body.append(frame);
</script></body></html>"""
WATCH = """<script>
window.broken = [];
window.addEventListener("error", (event) => window.broken.push(String(event.message)), true);
window.addEventListener("securitypolicyviolation", \
(event) => window.broken.push(event.violatedDirective));
</script>"""


def look(browser, page, checks, folder):
    """What statements in JavaScript, which fill ``seen``, find in a page.

    Nothing may be written to the console.
    """
    content = page.read_text().replace("<meta http-equiv", f"{WATCH}<meta http-equiv", 1)
    framed = FRAME.replace("CHECKS", checks).replace(
        "PAGE", json.dumps(content).replace("</", "<\\/")
    )
    file = folder / "framed.html"
    file.write_text(framed)
    done = browser("--virtual-time-budget=5000", "--dump-dom", file.as_uri())
    assert "CONSOLE" not in done.stderr, done.stderr
    (text,) = re.findall(r'<pre id="seen">(.*?)</pre>', done.stdout, re.DOTALL)
    return json.loads(text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
