// The page try.md: loads Pyodide when it is first needed, and inverts the file in the browser.
"use strict";
(() => {
  const form = document.getElementById("try-form");
  const shown = document.getElementById("try-answer");
  const here = new URL(".", document.currentScript.src);
  const pyodideUrl = new URL(form.dataset.pyodide, document.baseURI).href;
  const hashes = JSON.parse(form.dataset.integrity);
  let loading = null;

  function script(name) {
    return new Promise((done, failed) => {
      const element = document.createElement("script");
      Object.assign(element, { src: pyodideUrl + name, integrity: hashes[name], crossOrigin: "anonymous" });
      element.onload = done;
      element.onerror = () => failed(new Error(`${element.src} cannot be loaded`));
      document.head.append(element);
    });
  }

  // Pyodide asks for its packages with the hashes in its lock file, for all else without one, and
  // waits for ever where WebAssembly is refused.
  function checkHashes(failed) {
    const plain = window.fetch.bind(window);
    window.fetch = (resource, options = {}) => {
      const url = new URL(resource, document.baseURI).href;
      if (!url.startsWith(pyodideUrl)) return plain(resource, options);
      const integrity = hashes[url.slice(pyodideUrl.length)] ?? options.integrity;
      const answer = integrity ? plain(url, { ...options, integrity }) : Promise.reject(new Error("no hash"));
      answer.catch((error) => failed(new Error(`${url} cannot be loaded: ${error.message}`)));
      return answer;
    };
  }

  async function bytes(name) {
    const answer = await fetch(new URL(name, here));
    if (!answer.ok) throw new Error(`${name}: ${answer.status}`);
    return answer.arrayBuffer();
  }

  function load() {
    return Promise.race([new Promise((_, failed) => checkHashes(failed)), start()]);
  }

  async function start() {
    await script("pyodide.js");
    await script("pyodide.asm.js"); // before Pyodide would load it without a hash
    const pyodide = await loadPyodide({ indexURL: pyodideUrl });
    await pyodide.loadPackage(["click", "numpy", "packaging", "pandas", "pydantic", "threadpoolctl"]);
    const place = pyodide.runPython("import site; site.getsitepackages()[0]");
    pyodide.unpackArchive(await bytes("terraphi.zip"), "zip", { extractDir: place });
    const code = new TextDecoder().decode(await bytes("try.py"));
    return pyodide.runPythonAsync(`${code}\n(invert, example)`);
  }

  async function run(read) {
    const buttons = form.querySelectorAll("button");
    buttons.forEach((one) => { one.disabled = true; });
    try {
      shown.textContent = "Loading Python (about 25 MB the first time) …";
      loading ??= load();
      const [invert, example] = await loading;
      shown.textContent = "Inverting …";
      await new Promise((done) => { setTimeout(done, 50); });  // lets the browser draw
      const [name, content, options] = await read(example);
      const found = JSON.parse(invert(name, content, JSON.stringify(options)));
      shown.dataset.answer = JSON.stringify(found.answer ?? null);
      shown.textContent = found.error ?? found.text;
    } catch (error) {
      loading = null;
      shown.textContent = `This did not work: ${error.message}`;
    }
    buttons.forEach((one) => { one.disabled = false; });
  }

  function options() {
    const chosen = { rig: {} };
    for (const [name, value] of new FormData(form)) {
      if (typeof value !== "string" || !value.trim()) continue;
      if (name === "density") chosen.density = value.trim();
      else chosen.rig[name] = name === "leg" || name === "hip_height_mm" ? value.trim() : Number(value);
    }
    return chosen;
  }

  form.addEventListener("submit", (event) => {
    event.preventDefault();
    run(async () => {
      const [file] = form.elements.file.files;
      return [file.name, new Uint8Array(await file.arrayBuffer()), options()];
    });
  });

  document.getElementById("try-example").addEventListener("click", () => {
    run(async (example) => {
      const sizes = { leg: "c", length_mm: 76.2, width_mm: 25.4, thickness_mm: 6.4, hip_height_mm: 20 };
      return ["yuma-c.csv", new TextEncoder().encode(example()), { rig: sizes }];
    });
  });
})();
