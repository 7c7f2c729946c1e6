// Makes every block of Python of this page a cell that runs in the reader's browser. Without this script it stays a block.
// No module, which a page that is opened as a file would not load: it could not say why it does nothing.
"use strict";
const here = document.currentScript;
const UNLIKE = "(as typed)";
let worker, asked, plot; // asked: the cell that waits for an answer

function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** Lines `name = value  # or another or a third; unit`, each of which becomes a choice. */
function choices(code) {
  return [...code.matchAll(/^(\w+) = (.+?) {2}# or ([^;\n]+)(?:; (.+))?$/gm)].map(([, name, first, others, unit]) => ({
    name, unit, values: [first, ...others.split(" or ")],
  }));
}

const assignment = (name) => new RegExp(`^(${name} = )(.+?)(?=  #|$)`, "m");

class Cell {
  constructor(block, number) {
    this.code = block.textContent.trimEnd() + "\n";
    const heading = block.closest("section").querySelector("h1, h2");
    this.title = [...heading.childNodes].find((node) => node.nodeType === Node.TEXT_NODE).textContent;
    this.text = element("textarea", { value: this.code, spellcheck: false, id: `code-${number}`, rows: this.code.split("\n").length, autocomplete: "off" });
    this.text.setAttribute("autocapitalize", "off");
    this.button = element("button", { type: "button", className: "btn btn-primary", textContent: "Run" });
    this.button.setAttribute("aria-describedby", `state-${number}`);
    this.reset = element("button", { type: "button", className: "btn btn-secondary", textContent: "Code as it was" });
    this.state = element("span", { id: `state-${number}`, className: "state" });
    this.state.setAttribute("role", "status");
    this.output = element("div", { className: "answer-of-python" });
    this.selects = choices(this.code).map((choice) => this.select(choice, number));
    const label = element("label", { htmlFor: this.text.id, textContent: "Code" });
    this.root = element("div", { className: "cell" },
      element("div", { className: "choices" }, ...this.selects.map((each) => each.parentElement)),
      label, this.text, element("div", { className: "buttons" }, this.button, this.reset, this.state), this.output);
    this.root.setAttribute("role", "group");
    this.root.setAttribute("aria-label", this.title);
    block.replaceWith(this.root);
    this.button.addEventListener("click", () => (asked === this ? stop() : ask(this)));
    this.reset.addEventListener("click", () => { this.text.value = this.code; this.follow(); });
    this.text.addEventListener("input", () => this.follow());
    this.text.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) { event.preventDefault(); if (asked !== this) ask(this); }
    });
    new ResizeObserver(() => this.draw()).observe(this.output);
  }

  select({ name, unit, values }, number) {
    const id = `${name}-${number}`;
    const made = element("select", { id, name }, ...values.map((value) => element("option", { value, textContent: value.replace(/^tv\.(simulate\.)?/, "") })));
    made.addEventListener("change", () => {
      if (made.value !== UNLIKE) this.text.value = this.text.value.replace(assignment(name), (_, start) => start + made.value);
    });
    element("div", {}, element("label", { htmlFor: id, textContent: name.replace("_", " ") + (unit ? ` (${unit})` : "") }), made);
    return made;
  }

  /** Let the choices show what the code says. */
  follow() {
    for (const each of this.selects) {
      const value = this.text.value.match(assignment(each.name))?.[2];
      each.querySelector(`option[value="${UNLIKE}"]`)?.remove();
      if (![...each.options].some((option) => option.value === value)) each.append(element("option", { value: UNLIKE, textContent: UNLIKE }));
      each.value = [...each.options].some((option) => option.value === value) ? value : UNLIKE;
    }
  }

  show({ text, error, curves, seconds }) {
    this.curves = curves;
    this.output.replaceChildren();
    if (error) this.output.append(element("p", { className: "fault", textContent: error }));
    if (text) this.output.append(scrolling(element("pre", { textContent: text.trimEnd() }), `What ${this.title} prints`));
    this.figure = curves.length ? element("figure", {}) : null;
    if (this.figure) this.output.append(this.figure, scrolling(plot.table(curves), `Stiffness of ${this.title} in N·m/rad`));
    this.draw();
    this.say(error ? `Stopped by an error after ${seconds.toFixed(1)} s: ${error}` : `Done in ${seconds.toFixed(1)} s.`);
    document.dispatchEvent(new CustomEvent("tvsysid:ran", { detail: { title: this.title, code: this.text.value, text, error, curves, seconds } }));
  }

  draw() {
    const width = Math.floor(this.output.clientWidth);
    if (!this.figure || !width || this.width === width && this.figure.firstChild) return;
    this.width = width;
    this.figure.replaceChildren(plot.picture(this.curves, width));
  }

  say(words) { this.state.textContent = words; }
}

function scrolling(content, label) {
  const made = element("div", { className: "scroll", tabIndex: 0 }, content);
  made.setAttribute("role", "group");
  made.setAttribute("aria-label", label);
  return made;
}

function ask(cell) {
  if (asked) { cell.say("Wait, or stop the other one first: Python runs one at a time."); return; }
  worker ??= begin();
  asked = cell;
  cell.button.textContent = "Stop";
  cell.say("Starting …");
  worker.postMessage(cell.text.value);
}

function done() {
  const cell = asked;
  asked = undefined;
  if (cell) cell.button.textContent = "Run";
  return cell;
}

function stop(words = "Stopped. Python starts anew with the next run.") {
  worker?.terminate();
  worker = undefined;
  done()?.say(words);
}

function begin() {
  const made = new Worker(new URL("worker.js", here.src), { type: "module" });
  made.onmessage = ({ data }) => {
    if (data.state) asked?.say(data.state);
    else if (data.failed) stop(`Python could not run: ${data.failed}`);
    else done()?.show(data.result);
  };
  made.onerror = (event) => { event.preventDefault(); stop(`Python could not be loaded: ${event.message || "see the browser's console"}`); };
  return made;
}

/** Why code cannot run here, if it cannot. */
function hindrance() {
  if (!here.dataset.pyodide) return "This copy of the documentation was built without Python for browsers: take the code to a Python of your own, or build the site with it (CONTRIBUTING.md says how).";
  if (location.protocol === "file:") return "A browser runs Python only on pages that a server gives: in the site's folder, type “python -m http.server” and open http://localhost:8000/browser.html.";
  if (!globalThis.WebAssembly || !globalThis.Worker) return "This browser has no WebAssembly: take the code to a Python of your own.";
  return "";
}

const why = hindrance();
if (why) document.querySelector("article h1").after(element("p", { className: "hindrance", textContent: why }));
else import(new URL("plot.js", here.src)).then((module) => {
  plot = module;
  document.querySelectorAll("article div.highlight-python").forEach((block, number) => new Cell(block, number));
});
