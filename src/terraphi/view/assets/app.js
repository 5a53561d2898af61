"use strict";
const by = (id) => document.getElementById(id);

async function send(file) {
  const began = Date.now();
  const tick = setInterval(() => {
    by("say").textContent = `Reading ${file.name}: ${Math.round((Date.now() - began) / 1000)} s`;
  }, 250);
  const query = new URLSearchParams({ name: file.name, leg: by("leg").value, density: by("density").value });
  let found = { refused: "The file did not arrive: it may be too large, or the app has been stopped." };
  try {
    const answer = await fetch(`/answer?${query}`, { method: "POST", body: file, headers: { "x-terraphi": "1" } });
    found = await answer.json();
  } finally {
    clearInterval(tick);
    by("say").textContent = found.refused || "Done.";
  }
  if (found.page) location.href = found.page;
}

// A file that misses its place would otherwise replace the page.
for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
by("drop").addEventListener("dragover", () => by("drop").classList.add("over"));
by("drop").addEventListener("dragleave", () => by("drop").classList.remove("over"));
by("drop").addEventListener("drop", (event) => {
  by("drop").classList.remove("over");
  if (event.dataTransfer.files.length) send(event.dataTransfer.files[0]);
});
by("choose").addEventListener("click", () => by("file").click());
by("file").addEventListener("change", () => { if (by("file").files.length) send(by("file").files[0]); });
