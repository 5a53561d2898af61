const by = (id) => document.getElementById(id);
const form = by("form");
const token = new URLSearchParams(location.search).get("token");
const roles = JSON.parse(by("roles").textContent);
let file, kind, busy = 0;

function made(tag, properties, ...inside) {
  const one = Object.assign(document.createElement(tag), properties);
  one.append(...inside);
  return one;
}

// -- talking to the server ---------------------------------------------------------------------

const tool = () => form.elements.tool.value.trim();

function columns() {
  if (tool()) return Object.fromEntries(form.elements.tool_columns.value.split(",").filter(Boolean).map((pair) => pair.split("=").map((text) => text.trim())));
  const found = {};
  for (const select of document.querySelectorAll("#table select")) if (select.value) found[select.value] = select.dataset.column;
  for (const { name, value } of by("reading").querySelectorAll("[name]")) {
    if (value) found[name] = Number.isNaN(Number(value)) ? value : Number(value);
  }
  return found;
}

async function send(task) {
  const turn = ++busy, began = Date.now();
  const tell = () => { by("status").textContent = `${task === "look" ? "Reading" : "Working"}: ${Math.round((Date.now() - began) / 1000)} s`; };
  const tick = setInterval(tell, 500);
  tell();
  const { sd, hip_sd, tool_columns, ...query } = Object.fromEntries(new FormData(form));
  for (const [key, more] of [["hip_height", hip_sd], ["density", sd]]) if (query[key] && more) query[key] += `±${more}`;
  Object.assign(query, { name: file.name, columns: JSON.stringify(columns()) });
  let found = { refused: "The file did not arrive: it may be too large, or the app has been stopped." };
  try {
    const answer = await fetch(`/${task}?${new URLSearchParams(query)}`, { method: "POST", body: file, headers: { "x-terraphi": token } });
    found = await answer.json();
  } catch { /* as it is */ } finally {
    clearInterval(tick);
  }
  if (turn !== busy) return null; // something newer was asked
  by("status").textContent = "";
  alarm(found.refused || found.wrong);
  return found.refused ? null : found;
}

// -- what is wrong, and what would help ---------------------------------------------------------

const OFFER = /[,;]?\s*(?:add|or)?\s*--(columns|leg) (?:'([^']*)'|([\w=.,-]*\w\b))(?! --)/g;

function offers(text) {
  const values = [...text.matchAll(OFFER)].map(([, option, quoted, plain]) => [option, quoted ?? plain]);
  return values.filter(([, value]) => !/=(NAME|UNIT)/.test(value)).map(([option, value]) => made("button", {
    type: "button", textContent: `Use ${option === "leg" ? "leg " : ""}${value}`, onclick: () => apply(option, value),
  }));
}

function alarm(text) {
  by("alert").hidden = !text;
  if (!text) return;
  by("alert").replaceChildren(text.replace(OFFER, ""));
  by("alert").append(made("div", {}, ...offers(text)));
  by("alert").scrollIntoView({ block: "nearest" });
}

function take(role, column) {
  for (const select of document.querySelectorAll("#table select")) {
    if (select.dataset.column === column) select.value = role;
    else if (select.value === role) select.value = "";
  }
}

function apply(option, value) {
  if (option === "leg") form.elements.leg.value = value;
  else for (const pair of value.split(",")) {
    const [key, text] = pair.split("=");
    if (tool()) form.elements.tool_columns.value += `${form.elements.tool_columns.value && ","}${pair}`;
    else if (key in roles) take(key, text);
    else if (form.elements[key]) form.elements[key].value = text;
  }
  if (option === "leg" || (by("answer").childElementCount && form.checkValidity())) answer();
  else look();
}

// -- a preview -----------------------------------------------------------------------------------

function tabulate({ columns, units, rows, roles: taken, candidates }) {
  const head = columns.map((name, i) => {
    const select = made("select", { ariaLabel: `What ${name} is` }, made("option", { value: "", textContent: "not used" }));
    for (const [role, text] of Object.entries(roles)) select.append(made("option", { value: role, textContent: text }));
    select.dataset.column = name;
    select.value = Object.keys(taken).find((role) => taken[role] === name) || "";
    if (!taken.theta && !candidates.theta?.length && candidates.time?.[0] === name) select.value = "time";
    return made("th", { scope: "col" }, select, made("div", {}, name), made("div", { className: "note", textContent: units[i] || "no unit" }));
  });
  const body = rows.map((row) => made("tr", {}, ...row.map((cell) => made("td", { className: "short", textContent: cell ?? "" }))));
  by("table").replaceChildren(made("thead", {}, made("tr", {}, ...head)), made("tbody", {}, ...body));
}

function ask(...inside) {
  return made("div", { className: "question" }, ...inside);
}

function show(found) {
  by("read").replaceChildren(...(found.read || []).map((text) => made("div", {}, text)));
  by("questions").replaceChildren();
  if (!found.candidates) return; // of a tool
  const taken = columns(), questions = [], lacking = [];
  for (const [role, text] of Object.entries(roles)) {
    const may = (found.candidates[role] || []).filter((name) => !Object.values(taken).includes(name));
    if (taken[role] || role === "time" || (role === "theta" && taken.time)) continue;
    const buttons = may.map((name) => made("button", { type: "button", textContent: name, onclick: () => { take(role, name); look(); } }));
    if (may.length > 1) questions.push(ask(`Which column is the ${text}? `, ...buttons));
    else if (role !== "moment") lacking.push(text);
  }
  if (lacking.length && found.wrong) {
    questions.push(ask(`Which column is the ${lacking.join(", which the ")}? Choose above the table. `, ...offers(found.wrong)));
  }
  if (taken.time && !taken.theta && !taken.rate_deg_s) {
    questions.push(ask("There is a time and no angle. Enter the rate of the leg, and the angle at time 0 as what is added to the angle."));
  }
  for (const [role, name, usual] of [["theta", "theta_unit", "deg"], ["fz", "unit", "N"]]) {
    const unit = found.units[found.columns.indexOf(taken[role])];
    form.elements[name].options[0].text = unit ? `${unit} (header)` : usual;
  }
  by("questions").replaceChildren(...questions);
  if (questions.length) alarm("");
}

async function look() {
  // A tool has neither leg nor roles of columns.
  for (const part of [by("reading"), by("rig")]) part.hidden = part.disabled = Boolean(tool());
  for (const select of document.querySelectorAll("#table select")) select.hidden = Boolean(tool());
  const found = await send("look");
  if (found?.kind === "forces") show(found);
}

async function open(dropped) {
  file = dropped;
  form.reset();
  form.hidden = true;
  by("table").replaceChildren();
  by("answer").replaceChildren();
  by("name").textContent = file.name;
  const found = await send("look");
  if (!found) return;
  kind = found.kind;
  form.hidden = !["forces", "log"].includes(kind);
  by("forces").hidden = by("forces").inert = kind !== "forces";
  by("robot").hidden = kind !== "log";
  for (const label of document.querySelectorAll(".of-forces")) label.hidden = kind !== "forces";
  form.noValidate = kind !== "forces"; // what is hidden is required of forces alone
  if (kind !== "forces") { answer(); return; }
  tabulate(found);
  form.elements.leg.value = found.rig?.leg ?? "";
  for (const input of sizes()) input.value = found.rig?.[`${input.name}_mm`] ?? "";
  sketch();
  if (found.density) form.elements.density.value = found.density;
  show(found);
  by("table").querySelector("select").focus({ preventScroll: true });
}

// -- the leg, to scale ---------------------------------------------------------------------------

const sizes = () => by("rig").querySelectorAll("[data-li]");

// From the side as it hangs, with its end faces round; from the front beside it.
function sketch() {
  const [length, width, thick, height] = [...sizes()].map(({ value }) => Number(value));
  const chord = length - thick / 2;
  const bend = Number(form.querySelector("[name=leg]:checked")?.dataset.curvature ?? 0), radius = chord / 2 / Math.abs(bend);
  by("drawing").replaceChildren();
  if (!(length > 0 && width > 0 && thick > 0 && chord > 0 && height < length)) return;
  const from = -0.6 * length, far = 0.7 * length + width, top = -0.15 * length;
  const middle = bend === 0 ? `L0 ${chord}` : `A${radius} ${radius} 0 0 ${bend > 0 ? 0 : 1} 0 ${chord}`;
  const shapes = [
    ["rect", { x: from, y: height, width: far - from, height: 1.2 * length - height, fill: "#e8dcc5" }],
    ["path", { d: `M0 0${middle}`, fill: "none", stroke: "#0072B2", "stroke-width": thick, "stroke-linecap": "round" }],
    ["rect", { x: 0.6 * length, y: -thick / 2, width, height: length + thick / 2, fill: "#0072B2" }],
    ["circle", { r: 0.03 * length }],
  ];
  for (const [tag, attributes] of shapes) {
    const one = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
    by("drawing").append(one);
  }
  by("drawing").setAttribute("viewBox", `${from} ${top} ${far - from} ${1.2 * length - top}`);
}

by("rig").addEventListener("input", sketch);
by("li2013").addEventListener("click", () => {
  for (const input of sizes()) input.value = input.dataset.li;
  sketch();
});

// -- an answer -----------------------------------------------------------------------------------

async function answer() {
  const found = await send("answer");
  if (!found) return;
  const stem = file.name.replace(/\.[^.]*$/, "");
  const links = Object.entries(found.files).map(([name, content]) => {
    const blob = new Blob([Uint8Array.from(atob(content), (c) => c.charCodeAt(0))]);
    return made("a", { href: URL.createObjectURL(blob), download: `${stem}-${name}`, textContent: name });
  });
  by("answer").innerHTML = found.html;
  const box = by("answer").querySelector(".answer");
  box.append(made("p", { className: "offers" }, ...offers(box.textContent)));
  box.append(made("p", {}, "Download: ", ...links.flatMap((link, i) => (i ? [", ", link] : [link]))));
  by("answer").focus({ preventScroll: true });
  by("answer").scrollIntoView();
}

// A file that misses its place would otherwise replace the page.
for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
by("drop").addEventListener("dragover", () => by("drop").classList.add("over"));
by("drop").addEventListener("dragleave", () => by("drop").classList.remove("over"));
by("drop").addEventListener("drop", (event) => {
  by("drop").classList.remove("over");
  if (event.dataTransfer.files.length) open(event.dataTransfer.files[0]);
});
by("choose").addEventListener("click", () => by("file").click());
by("file").addEventListener("change", () => { if (by("file").files.length) open(by("file").files[0]); by("file").value = ""; });
form.addEventListener("submit", (event) => { event.preventDefault(); answer(); });
form.addEventListener("change", (event) => {
  const { value, dataset } = event.target;
  by("answer").replaceChildren(); // it was for other choices
  if (dataset.column && value) take(value, dataset.column);
  if (event.target.closest("#table, #reading") || event.target.name.startsWith("tool")) look();
});
