// Walks through docs/browser.md in Chromium, as it was built: every cell with every choice, its numbers against those of a
// native Python, the keyboard alone, an error, Stop, axe-core in light and dark, a narrow screen. README.md says how to run it.
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { execFileSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, extname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const [site, python = "python", shots = "build/browser/pictures"] = process.argv.slice(2);
const require = createRequire(resolve("build/browser/package.json"));
const { chromium } = require("playwright-core");
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css", ".json": "application/json", ".wasm": "application/wasm", ".svg": "image/svg+xml", ".png": "image/png" };
const faults = [];
const check = (holds, words) => { if (!holds) faults.push(words); console.log(`${holds ? "ok " : "NOT"} ${words}`); };

const server = createServer((request, response) => {
  if (request.url === "/favicon.ico") { response.writeHead(204).end(); return; } // asked for by the browser, not by the page
  const path = join(resolve(site), decodeURIComponent(new URL(request.url, "http://x").pathname));
  try {
    if (!statSync(path).isFile()) throw new Error();
    response.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" }).end(readFileSync(path));
  } catch { response.writeHead(404).end(); }
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const origin = `http://127.0.0.1:${server.address().port}`;

mkdirSync(shots, { recursive: true });
const flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];
const browser = await chromium.launchPersistentContext(mkdtempSync(join(tmpdir(), "chromium-")), {
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: flags, viewport: { width: 1280, height: 900 },
});
const page = browser.pages()[0];
const outside = [], failed = [], said = [];
browser.on("request", (request) => { if (!request.url().startsWith(origin) && !/^(data|blob):/.test(request.url())) outside.push(request.url()); });
browser.on("response", (response) => { if (response.status() >= 400) failed.push(`${response.status()} ${response.url()}`); });
page.on("console", (message) => { if (["error", "warning"].includes(message.type())) said.push(`${message.type()}: ${message.text()}`); });
page.on("pageerror", (error) => said.push(String(error)));
await page.addInitScript(() => {
  globalThis.results = [];
  document.addEventListener("tvsysid:ran", (event) => globalThis.results.push(event.detail));
});
page.setDefaultTimeout(100_000);

const count = () => page.evaluate(() => globalThis.results.length);
async function ran(act) { // what a run gives that `act` sets off
  const before = await count();
  await act();
  await page.waitForFunction((known) => globalThis.results.length > known, before);
  return page.evaluate(() => globalThis.results.at(-1));
}

await page.goto(`${origin}/browser.html`);
const cells = page.locator(".cell");
await cells.first().waitFor();
check((await cells.count()) === 6, "six cells");
check(outside.length === 0 && !(await page.evaluate(() => performance.getEntriesByType("resource").some((each) => each.name.includes("pyodide/")))), "nothing of Python is loaded before Run is pressed");

// The keyboard alone: from the first choice through the code to Run.
await cells.nth(0).locator("select").first().focus();
const began = Date.now();
for (let i = 0; i < 5; i++) await page.keyboard.press("Tab");
check(await page.evaluate(() => document.activeElement.tagName === "TEXTAREA"), "Tab goes from the choices to the code");
await page.keyboard.press("Tab");
check(await page.evaluate(() => document.activeElement.textContent === "Run"), "Tab leaves the code, for Run");
const first = await ran(() => page.keyboard.press("Enter"));
const loaded = (Date.now() - began) / 1000;
check(!first.error && first.curves.length === 2, `first run from the keyboard: ${loaded.toFixed(1)} s with loading, ${first.seconds.toFixed(1)} s of it the code`);
await cells.nth(0).locator("textarea").focus();
await ran(() => page.keyboard.press("Control+Enter"));
check((await cells.nth(0).locator("[role=status]").textContent()).startsWith("Done in"), "Ctrl+Enter runs, and the status says so");

// Every cell with each of its choices, one at a time.
await page.evaluate(() => { globalThis.results = []; });
for (let number = 0; number < (await cells.count()); number++) {
  const cell = cells.nth(number);
  const run = () => cell.getByRole("button", { name: "Run", exact: true }).click();
  await ran(run);
  const selects = cell.locator("select");
  for (let i = 0; i < (await selects.count()); i++) {
    const values = await selects.nth(i).locator("option").evaluateAll((options) => options.map((option) => option.value));
    for (const value of values.slice(1)) {
      await selects.nth(i).selectOption(value);
      await ran(run);
    }
    await selects.nth(i).selectOption(values[0]);
  }
  check((await cell.locator("textarea").inputValue()).includes("  # or "), `cell ${number + 1}: choices leave the code's own words`);
}
const results = await page.evaluate(() => globalThis.results);
const native = JSON.parse(execFileSync(python, [join(dirname(fileURLToPath(import.meta.url)), "native.py")], { input: JSON.stringify(results.map((each) => each.code)), maxBuffer: 1 << 28 }));
let furthest = 0, texts = 0;
results.forEach((each, i) => {
  if (each.text !== native[i].text || each.error !== native[i].error) console.log(`  differs:\n${each.text}${each.error}\n${native[i].text}${native[i].error}`);
  else texts++;
  each.curves.forEach((curve, j) => {
    for (const key of ["values", "lower", "upper"]) {
      curve[key]?.forEach((value, k) => {
        const other = native[i].curves[j][key][k];
        if ((value === null) !== (other === null)) furthest = Infinity;
        else if (value !== null) furthest = Math.max(furthest, Math.abs(value - other) / Math.max(1, Math.abs(other)));
      });
    }
  });
});
check(texts === results.length, `${texts} of ${results.length} runs print the same as native Python`);
check(furthest < 1e-6, `curves and bands differ from native Python by ${furthest.toExponential(1)} of their value at most`);
for (const title of new Set(results.map((each) => each.title))) {
  const times = results.filter((each) => each.title === title).map((each) => each.seconds);
  console.log(`    ${title}: ${times.length} runs, ${Math.min(...times).toFixed(1)} to ${Math.max(...times).toFixed(1)} s`);
}

// Errors, a choice of the reader's own, Stop.
const cell = cells.nth(1), code = cell.locator("textarea"), status = cell.locator("[role=status]");
const own = await code.inputValue();
await code.fill(own.replace("duration = 40", "duration = 50"));
check((await cell.locator("select").inputValue()) === "(as typed)", "a value that is no choice shows as typed");
await code.fill("import tvsysid as tv\ntv.ShortDataSegments(window=-1)\n");
const wrong = await ran(() => cell.getByRole("button", { name: "Run", exact: true }).click());
check(/^Line 2: InputError: /.test(wrong.error) && (await cell.locator(".fault").isVisible()), `an error is read: ${wrong.error}`);
await code.fill("def f(:\n");
check(/^Line 1: SyntaxError: /.test((await ran(() => cell.getByRole("button", { name: "Run", exact: true }).click())).error), "so is a wrong line");
await code.fill("while True: pass\n");
await cell.getByRole("button", { name: "Run", exact: true }).click();
await page.waitForFunction((element) => element.textContent === "Running …", await status.elementHandle());
await cell.getByRole("button", { name: "Stop", exact: true }).click();
check((await status.textContent()).startsWith("Stopped."), "Stop stops a loop without end");
await cell.getByRole("button", { name: "Code as it was" }).click();
check((await code.inputValue()) === own, "the code comes back");
const again = Date.now();
await ran(() => cell.getByRole("button", { name: "Run", exact: true }).click());
check(true, `and runs in a new Python, after ${((Date.now() - again) / 1000).toFixed(1)} s`);

// What it looks like, and axe-core.
await page.addScriptTag({ path: require.resolve("axe-core/axe.min.js") });
for (const width of [1280, 360]) {
  for (const mode of ["light", "dark"]) {
    await page.setViewportSize({ width, height: 900 });
    await page.evaluate((theme) => { document.documentElement.dataset.theme = theme; document.documentElement.dataset.mode = theme; }, mode);
    await page.waitForTimeout(300);
    const found = await page.evaluate(() => globalThis.axe.run({ runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"] }));
    const serious = found.violations.filter((each) => ["serious", "critical"].includes(each.impact));
    check(serious.length === 0, `axe-core, ${mode}, ${width} px: ${serious.length} serious of ${found.violations.length}${found.violations.map((each) => ` [${each.impact} ${each.id}: ${each.nodes[0].target}]`).join("")}`);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    check(wide <= 0, `no sideways scrolling at ${width} px`);
    await page.screenshot({ path: join(shots, `${mode}-${width}.png`), fullPage: true });
    await cells.nth(3).screenshot({ path: join(shots, `cell-${mode}-${width}.png`) });
  }
}
check(outside.length === 0, `no request leaves the site ${outside}`);
check(failed.length === 0, `no request fails ${failed}`);
check(said.length === 0, `no error in the console ${said.join("; ")}`);
writeFileSync(join(shots, "results.json"), JSON.stringify(results));
await browser.close();
server.close();
console.log(faults.length ? `${faults.length} failed` : "all is well");
process.exit(faults.length ? 1 : 0);
