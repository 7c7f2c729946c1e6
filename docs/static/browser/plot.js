// The picture of a block of code: stiffness over time, bands, the truth; and the table that says the same in numbers.
const SVG = "http://www.w3.org/2000/svg";
const DASHES = ["", "8 4", "2 3", "10 3 2 3"];
const HEIGHT = 260, LEFT = 52, RIGHT = 10, TOP = 10, BOTTOM = 42;

function part(parent, name, attributes = {}, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  parent.append(made);
  return made;
}

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => Number(((first + i) * step).toPrecision(6)));
}

const finite = (values) => values.filter((value) => value !== null);
const extent = (values) => values.reduce(([low, high], each) => [Math.min(low, each), Math.max(high, each)], [Infinity, -Infinity]);
const mean = (values) => values.reduce((sum, each) => sum + each, 0) / values.length;
const halfWidth = (curve) => mean(finite(curve.lower.map((low, i) => (low === null || curve.upper[i] === null ? null : (curve.upper[i] - low) / 2))));
const number = (value) => (Math.abs(value) < 1e5 ? value.toFixed(1) : value.toExponential(2));

/** What a curve says, in numbers: name, mean, lowest, highest, half the band, share of the times at which it holds. */
export function summary(curve) {
  const [low, high] = extent(finite(curve.values));
  const band = curve.lower ? `± ${number(halfWidth(curve))}` : "–";
  const holds = curve.holds == null ? "–" : `${(100 * curve.holds).toFixed(0)} %`;
  return [curve.name, number(mean(finite(curve.values))), number(low), number(high), band, holds];
}

/** SVG of all curves, so wide. */
export function picture(curves, width) {
  const svg = document.createElementNS(SVG, "svg");
  for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${HEIGHT}`, width, height: HEIGHT, role: "img" })) svg.setAttribute(key, value);
  const [start, end] = extent(curves.flatMap((curve) => curve.time));
  let [low, high] = extent(curves.flatMap((curve) => finite([...curve.values, ...(curve.lower ?? []), ...(curve.upper ?? [])])));
  if (high - low < 1) [low, high] = [low - 1, high + 1];
  [low, high] = [low - 0.04 * (high - low), high + 0.04 * (high - low)];
  const x = (time) => LEFT + ((time - start) / (end - start || 1)) * (width - LEFT - RIGHT);
  const y = (value) => TOP + ((high - value) / (high - low)) * (HEIGHT - TOP - BOTTOM);
  svg.setAttribute("aria-label", `Stiffness in newton metres per radian over ${number(end - start)} seconds. ` +
    curves.map((curve) => { const [name, middle, least, most, band] = summary(curve); return `${name}: mean ${middle}, from ${least} to ${most}${curve.lower ? `, band ${band}` : ""}`; }).join("; ") + ".");
  for (const value of ticks(low, high, 5)) {
    part(svg, "line", { x1: LEFT, x2: width - RIGHT, y1: y(value), y2: y(value), class: "grid" });
    part(svg, "text", { x: LEFT - 6, y: y(value) + 4, "text-anchor": "end" }, String(value));
  }
  for (const time of ticks(start, end, width < 500 ? 4 : 8)) {
    part(svg, "line", { x1: x(time), x2: x(time), y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM + 4, class: "axis" });
    part(svg, "text", { x: x(time), y: HEIGHT - BOTTOM + 18, "text-anchor": "middle" }, String(time));
  }
  part(svg, "line", { x1: LEFT, x2: width - RIGHT, y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM, class: "axis" });
  part(svg, "text", { x: (LEFT + width - RIGHT) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, "time (s)");
  part(svg, "text", { transform: `translate(13 ${(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle" }, "stiffness (N·m/rad)");
  curves.forEach((curve, index) => {
    const point = (values, i) => `${x(curve.time[i]).toFixed(1)},${y(values[i]).toFixed(1)}`;
    const known = (values) => curve.time.map((_, i) => i).filter((i) => values[i] !== null);
    if (curve.lower) {
      const there = known(curve.lower).filter((i) => curve.upper[i] !== null);
      const outline = [...there.map((i) => point(curve.upper, i)), ...there.reverse().map((i) => point(curve.lower, i))];
      part(svg, "polygon", { points: outline.join(" "), class: `band ${kind(curve, index)}` });
    }
    part(svg, "polyline", { points: known(curve.values).map((i) => point(curve.values, i)).join(" "), class: `line ${kind(curve, index)}`, "stroke-dasharray": dash(curve, index) });
  });
  return svg;
}

const kind = (curve, index) => (curve.name === "truth" ? "truth" : `curve${index % 4}`);
const dash = (curve, index) => (curve.name === "truth" ? "" : DASHES[index % DASHES.length]);

/** Table of all curves, which is the legend too. */
export function table(curves) {
  const made = document.createElement("table");
  const head = made.createTHead().insertRow();
  for (const title of ["curve", "mean", "lowest", "highest", "95 % band", "holds the truth at"]) {
    const cell = document.createElement("th");
    cell.scope = "col";
    cell.textContent = title;
    head.append(cell);
  }
  const body = made.createTBody();
  curves.forEach((curve, index) => {
    const row = body.insertRow(), name = document.createElement("th");
    name.scope = "row";
    row.append(name);
    const sample = document.createElementNS(SVG, "svg");
    for (const [key, value] of Object.entries({ width: 28, height: 10, "aria-hidden": "true" })) sample.setAttribute(key, value);
    part(sample, "line", { x1: 0, x2: 28, y1: 5, y2: 5, class: `line ${kind(curve, index)}`, "stroke-dasharray": dash(curve, index) });
    const [title, ...rest] = summary(curve);
    name.append(sample, ` ${title}`);
    for (const text of rest) row.insertCell().textContent = text;
  });
  return made;
}
