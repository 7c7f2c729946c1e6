// Python beside the page: loads Pyodide, NumPy, SciPy and tvsysid when first asked to, and runs one block of code at a time.
import { loadPyodide } from "../pyodide/pyodide.mjs";

const say = (state) => postMessage({ state });
let python;

async function start() {
  const base = new URL("../pyodide/", import.meta.url).href;
  say("Loading Python …");
  const pyodide = await loadPyodide({ indexURL: base });
  say("Loading NumPy and SciPy …");
  await pyodide.loadPackage(["numpy", "scipy"], { messageCallback() {} });
  say("Loading tvsysid …");
  const folder = pyodide.runPython("import site; site.getsitepackages()[0]");
  pyodide.unpackArchive(await content(`${base}packages.zip`), "zip", { extractDir: folder });
  pyodide.runPython(await (await fetch(new URL("run.py", import.meta.url))).text());
  pyodide.runPython("import tvsysid.methods, tvsysid.preprocess, tvsysid.simulate"); // now, not within the first run
  return pyodide.globals.get("run");
}

async function content(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url}: ${response.status} ${response.statusText}`);
  return response.arrayBuffer();
}

onmessage = async ({ data }) => {
  try {
    python ??= start();
    const run = await python;
    say("Running …");
    const began = performance.now();
    const result = JSON.parse(run(data));
    postMessage({ result: { ...result, seconds: (performance.now() - began) / 1000 } });
  } catch (fault) {
    postMessage({ failed: String(fault.message ?? fault).trim().split("\n").pop() });
  }
};
