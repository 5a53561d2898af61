"use strict";
const by = (id) => document.getElementById(id);
const place = by("drop"), say = by("say");

function query(file) {
  const asked = new URLSearchParams({ name: file.name });
  for (const name of ["kind", "leg", "library", "density", "noise"]) asked.set(name, by(name).value);
  return asked;
}

async function send(file) {
  const began = Date.now();
  const tick = setInterval(() => {
    say.textContent = `Reading ${file.name}: ${Math.round((Date.now() - began) / 1000)} s`;
  }, 250);
  try {
    const answer = await fetch(`/report?${query(file)}`, { method: "POST", body: file, headers: { "x-terraphi": "1" } });
    const found = await answer.json();
    if (found.page) location.href = found.page;
    clearInterval(tick);
    say.textContent = found.refused || "Done.";
  } catch (error) {
    clearInterval(tick);
    say.textContent = "The file did not arrive: it may be too large, or the app has been stopped.";
  }
}

place.addEventListener("dragover", (event) => { event.preventDefault(); place.classList.add("over"); });
place.addEventListener("dragleave", () => place.classList.remove("over"));
place.addEventListener("drop", (event) => {
  event.preventDefault();
  place.classList.remove("over");
  if (event.dataTransfer.files.length) send(event.dataTransfer.files[0]);
});
// A file that misses its place would otherwise replace the page.
for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
by("choose").addEventListener("click", () => by("file").click());
by("file").addEventListener("change", () => { if (by("file").files.length) send(by("file").files[0]); });
