// The explorer by its keyboard alone, from a file to a band, in headless Chromium; explorer.py opens it and runs this
// with its address, the channels, and the folder for pictures of the page.
import fs from "node:fs";
import { createRequire } from "node:module";
const require = createRequire(`${process.cwd()}/build/browser/`);
const { chromium } = require("playwright-core");
const [executablePath, address, angle, torque, folder] = process.argv.slice(2);
const LIMIT_MS = 1000;
const flags = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"];
const browser = await chromium.launch({ executablePath, args: [...flags, "--disable-component-update", "--disable-sync"] });
const wrong = [];
const check = (right, what) => (console.log(`${right ? "ok   " : "WRONG"} ${what}`), right || wrong.push(what));

async function opened(options) {
  const page = await (await browser.newContext(options)).newPage();
  page.on("request", (request) => {
    if (!/^(data:|blob:)/.test(request.url()) && new URL(request.url()).host !== new URL(address).host)
      check(false, `asks another host: ${request.url()}`);
  });
  page.on("pageerror", (error) => check(false, `script: ${error}`));
  await page.goto(address);
  await page.waitForSelector("#answer .alert");
  return page;
}
const focused = (page) =>
  page.evaluate(() => {
    const there = document.activeElement;
    const style = getComputedStyle(there);
    const label = there.labels?.[0]?.innerText ?? there.innerText ?? there.getAttribute("aria-label");
    return { id: there.id, label: (label ?? "").trim(), ring: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2 };
  });
async function tabTo(page, id) {
  const passed = [];
  for (let presses = 0; presses < 60; presses++) {
    await page.keyboard.press("Tab");
    const now = await focused(page);
    passed.push(now);
    if (now.id === id) return passed;
  }
  throw new Error(`no way to ${id} by Tab: ${passed.map((each) => each.id || each.label)}`);
}
const typed = async (page, text) => (await page.keyboard.press("Control+A"), await page.keyboard.type(text), await page.keyboard.press("Enter"));
const choose = (page, beginning) => page.keyboard.type(beginning);
const picture = (page) => page.evaluate(() => document.querySelector("figure img")?.src ?? "");
// From a key to the next frame after another picture has been decoded, as seen within the page.
async function drawn(page, what, act, limit = LIMIT_MS) {
  await page.waitForTimeout(1200); // a list forgets what was typed before
  const started = await page.evaluate((before) => {
    window.changed = new Promise((done) => {
      const look = () => {
        const image = document.querySelector("figure img");
        if (image && image.src !== before) image.decode().then(() => requestAnimationFrame(() => done(performance.now())));
        else setTimeout(look, 5);
      };
      look();
    });
    return performance.now();
  }, await picture(page));
  await act();
  const took = (await page.evaluate(() => Promise.race([window.changed, new Promise((done) => setTimeout(() => done(NaN), 60000))]))) - started;
  check(took < limit, `${what}: drawn in ${took.toFixed(0)} ms (load ${fs.readFileSync("/proc/loadavg", "utf8").split(" ")[0]})`);
}
async function examined(page, name) {
  await page.waitForTimeout(1500);
  if (!(await page.evaluate(() => window.axe))) await page.addScriptTag({ path: require.resolve("axe-core/axe.min.js") });
  const { violations } = await page.evaluate(() => window.axe.run());
  for (const each of violations) console.log(`      axe: ${each.impact} ${each.id}: ${each.nodes.map((node) => node.html.slice(0, 90))}`);
  check(!violations.some((each) => ["serious", "critical"].includes(each.impact)), `axe finds nothing serious: ${name}`);
  check(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `nothing is wider than the page: ${name}`);
  await page.screenshot({ path: `${folder}/${name}.png`, fullPage: true });
}
const answer = (page) => page.evaluate(() => document.querySelector("#answer").innerText);

const page = await opened({ colorScheme: "light", viewport: { width: 1200, height: 900 } });
check((await answer(page)).includes("choose the channel"), `says what to do first: ${await answer(page)}`);
await examined(page, "first");
let passed = await tabTo(page, "angle");
await choose(page, angle);
passed.push(...(await tabTo(page, "torque")));
await choose(page, torque);
passed.push(...(await tabTo(page, "sampling_rate")));
await typed(page, "1000");
passed.push(...(await tabTo(page, "reversed")));
await page.keyboard.press("Space");
passed.push(...(await tabTo(page, "period")));
await drawn(page, "the first identification, file and all", () => typed(page, "2"), 30000);
await page.waitForSelector("#judged p"); // the answer waits for the diagnosis
check(/recommended \(adaptive\): stiffness/.test(await answer(page)), await answer(page).then((text) => text.split("\n")[0]));
await examined(page, "light");
passed.push(...(await tabTo(page, "method")));
for (const key of ["eirf", "sds", "birf", "esm", "kbr"]) await drawn(page, `method ${key}`, () => choose(page, `${key}:`));
await drawn(page, "method sds again", () => choose(page, "sds:"));
const window_ = await page.evaluate(() => [...document.querySelectorAll("input[id$=_window]")].find((each) => each.offsetParent).id);
passed.push(...(await tabTo(page, window_)));
await drawn(page, "a window of 0.3 s", () => typed(page, "0.3"));
check((await page.inputValue("#again0")).includes("--method sds:window=0.3"), await page.inputValue("#again0"));
passed.push(...(await tabTo(page, "band")));
await drawn(page, "a simultaneous band", () => page.keyboard.press("ArrowDown"));
for (let back = 0; back < 60 && (await focused(page)).id !== "period"; back++) await page.keyboard.press("Shift+Tab");
await drawn(page, "a period of 4 s", () => typed(page, "4"));
const dead = async (text) => (await typed(page, text), await page.waitForSelector("#answer .alert-danger"), answer(page));
check(/4000|duration|long|realization/i.test(await dead("4000")), `an error on the page: ${await answer(page)}`);
await examined(page, "error");
await drawn(page, "and back", () => typed(page, "2"));
passed.push(...(await tabTo(page, "again0")));
check(await page.evaluate(() => getSelection().toString() !== "" || document.activeElement.selectionEnd > 0), "the command is selected, to copy");
const unlabelled = passed.filter((each) => !each.label && each.id);
check(!unlabelled.length, `every control has a label ${unlabelled.map((each) => each.id)}`);
check(passed.every((each) => each.ring), `the focus is always seen ${passed.filter((each) => !each.ring).map((each) => each.id)}`);
const live = await page.evaluate(() => ["answer", "judged", "picture", "numbers", "again"].map((id) => document.getElementById(id).ariaLive));
check(live.join() === "polite,polite,off,off,off", `what is announced: ${live}`);
check(await page.evaluate(() => document.querySelector("figure img").alt.length > 20 && document.querySelectorAll("#numbers tbody tr").length > 8), "the picture has a text and a table");
console.log(`order of focus: ${[...new Set(passed.map((each) => each.id || each.label))].join(", ")}`);
const phone = await opened({ colorScheme: "dark", viewport: { width: 360, height: 740 } });
for (const [id, act] of [["angle", () => choose(phone, angle)], ["torque", () => choose(phone, torque)], ["sampling_rate", () => typed(phone, "1000")], ["reversed", () => phone.keyboard.press("Space")], ["period", () => typed(phone, "2")]]) {
  await tabTo(phone, id);
  await act();
}
await phone.waitForSelector("#judged p");
await examined(phone, "dark-360");
await browser.close();
console.log(wrong.length ? `${wrong.length} wrong` : "all as it should be");
process.exit(wrong.length ? 1 : 0);
