const by = (id) => document.getElementById(id);
const form = by("form");
const token = new URLSearchParams(location.search).get("token");
const roles = JSON.parse(by("roles").textContent);
let files = [], shown, kind, chosen = {}, busy = 0, running;

function made(tag, properties, ...inside) {
  const one = Object.assign(document.createElement(tag), properties);
  one.append(...inside);
  return one;
}

// -- talking to the server ---------------------------------------------------------------------

const isToml = ({ file }) => /\.toml$/i.test(file.name);
const body = (entry) => entry?.body.trim() || form.elements.tool.value.trim();
const tool = () => (body(shown).includes(":") ? body(shown) : "");

function columns(task) {
  // Of several files each is guessed by itself, but for what was chosen.
  const found = task === "answer" && files.length > 1 ? { ...chosen } : { ...chosen, ...roleColumns() };
  if (task === "look" ? tool() : form.elements.tool.value.trim()) {
    return Object.fromEntries(form.elements.tool_columns.value.split(",").filter(Boolean).map((pair) => pair.split("=").map((text) => text.trim())));
  }
  for (const { name, value } of by("reading").querySelectorAll("[name]")) {
    if (value) found[name] = Number.isNaN(Number(value)) ? value : Number(value);
  }
  return found;
}

function roleColumns() {
  const found = {};
  for (const select of document.querySelectorAll("#table select")) if (select.value) found[select.value] = select.dataset.column;
  return found;
}

function idle() {
  running?.abort();
  by("status").hidden = true;
  return ++busy;
}

async function send(task, entries = files) {
  const turn = idle(), began = Date.now(), most = Number(by("drop").dataset.megabytes);
  if (entries.reduce((sum, { file }) => sum + file.size, 0) > 1e6 * most) {
    alarm(`${entries.map(({ file }) => file.name).join(", ")}: larger than ${most} MB; use the command line.`);
    return null;
  }
  let doing = { stage: task === "look" ? "Reading" : "Working" };
  running = new AbortController();
  const tell = () => {
    const left = Math.round(doing.left_s - (Date.now() - doing.at) / 1000);
    by("stage").textContent = `${doing.stage}: ${Math.round((Date.now() - began) / 1000)} s${left > 0 ? `, about ${left} s left` : ""}`;
  };
  const tick = setInterval(tell, 500);
  tell();
  by("status").hidden = false;
  const { sd, hip_sd, tool_columns, ...query } = Object.fromEntries(new FormData(form));
  for (const [key, more] of [["hip_height", hip_sd], ["density", sd]]) if (query[key] && more) query[key] += `±${more}`;
  if (task === "look") query.tool = tool();
  const address = new URLSearchParams({ ...query, columns: JSON.stringify(columns(task)) });
  for (const entry of entries) {
    for (const [key, value] of [["name", entry.file.name], ["size", entry.file.size], ["body", entry.body.trim()]]) address.append(key, value);
  }
  let text = "", found = { refused: "The files did not arrive: they may be too large, or the app has been stopped." };
  try {
    const reply = await fetch(`/${task}?${address}`, {
      method: "POST", body: new Blob(entries.map(({ file }) => file)), headers: { "x-terraphi": token }, signal: running.signal,
    });
    const reader = reply.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      const lines = (text + part.value).split("\n");
      text = lines.pop();
      for (const line of lines) doing = { ...JSON.parse(line), at: Date.now() };
    }
    found = JSON.parse(text);
  } catch { /* as it is */ } finally {
    clearInterval(tick);
  }
  if (turn !== busy) return null; // something newer was asked, or it was cancelled
  idle();
  alarm(found.refused || found.wrong);
  return found.refused ? null : found;
}

// -- what is wrong, and what would help ---------------------------------------------------------

const OFFER = /[,;]?\s*(?:add|or)?\s*--(columns|leg) (?:'([^']*)'|([\w=.,-]*(?:\w\b|%)))(?! --)/g;

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
  for (const key of Object.keys(chosen)) if (chosen[key] === column) delete chosen[key];
  if (role) chosen[role] = column;
  for (const select of document.querySelectorAll("#table select")) {
    if (select.dataset.column === column) select.value = role;
    else if (role && select.value === role) select.value = "";
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
    if (!taken.theta && !candidates.theta?.length && candidates.time?.[0] === name) { select.value = "time"; chosen.time = name; }
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
  by("picture").hidden = !found.picture;
  if (found.picture) by("picture").src = found.picture;
  by("questions").replaceChildren();
  if (!found.candidates) return; // of a tool
  const taken = columns("look"), questions = [], lacking = [];
  if (found.wrong && found.columns.some((name) => /slip|sink/i.test(name))) {
    by("questions").replaceChildren(ask("Is this of a plate, a ball or a wheel? Enter its sizes below."));
    alarm("");
    return;
  }
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
  const isTool = Boolean(form.elements.tool.value.trim());
  for (const part of [by("reading"), by("rig")]) part.hidden = part.disabled = isTool;
  for (const select of document.querySelectorAll("#table select")) select.hidden = Boolean(tool());
  const found = await send("look", [shown]);
  if (found?.kind === "forces") show(found);
  return found;
}

// Names of all files: a press shows one of them, a body of its own is a leg or a tool.
function list() {
  by("files").replaceChildren(...files.map((entry) => made("li", {},
    made("button", { type: "button", textContent: entry.file.name, ariaPressed: String(entry === shown), disabled: isToml(entry), onclick: () => display(entry) }),
    isToml(entry) ? "calibration" : made("input", { value: entry.body, placeholder: "leg or tool as below", ariaLabel: `Leg or tool of ${entry.file.name}`, onchange: ({ target }) => { entry.body = target.value; display(entry); } }),
    made("button", { type: "button", textContent: "×", ariaLabel: `Leave out ${entry.file.name}`, onclick: () => leaveOut(entry) }),
  )));
  for (const input of by("files").querySelectorAll("input")) input.setAttribute("list", "bodies");
}

function leaveOut(entry) {
  files = files.filter((other) => other !== entry);
  if (files.every(isToml)) { idle(); form.hidden = true; } else display(entry === shown ? files[0] : shown);
}

// The first rows of a file, and what was read.
async function display(entry) {
  if (entry !== shown) by("table").replaceChildren();
  shown = entry;
  list();
  const found = await look();
  if (found?.columns) { tabulate(found); show(found); }
  return found;
}

async function open(dropped, more) {
  const added = [...dropped].map((file) => ({ file, body: "" })), tables = added.filter((entry) => !isToml(entry));
  const anew = form.hidden || !(more || !tables.length);
  if (anew && !tables.length) { alarm("Choose the forces as well: a rig or a calibration goes with them."); return; }
  by("answer").replaceChildren();
  const mine = files = [...(anew ? [] : files), ...added].sort((a, b) => isToml(a) - isToml(b));
  if (anew) {
    form.reset();
    form.hidden = true;
    by("table").replaceChildren();
    chosen = {};
    await begin();
  } else if (tables.length) await display(tables[0]);
  for (const entry of added.filter(isToml)) {
    if (files !== mine || form.hidden) return;
    const found = await send("look", [entry]);
    if (found?.kind === "rig") fill(found.rig);
    if (found?.kind !== "calibration") mine.splice(mine.indexOf(entry), 1);
    list();
  }
}

// The first of new files decides what the form asks for; what needs no choice is answered at once.
async function begin() {
  shown = files[0];
  list();
  const found = await look();
  if (!found) return;
  kind = found.kind;
  form.hidden = !["forces", "log"].includes(kind);
  by("forces").hidden = by("forces").inert = kind !== "forces";
  by("robot").hidden = kind !== "log";
  for (const label of document.querySelectorAll(".of-forces")) label.hidden = kind !== "forces";
  form.noValidate = kind !== "forces"; // what is hidden is required of forces alone
  if (kind !== "forces") { answer(); return; }
  tabulate(found);
  fill(found.rig);
  if (found.density) form.elements.density.value = found.density;
  show(found);
  by("table").querySelector("select").focus({ preventScroll: true });
}

function fill(rig) {
  form.elements.leg.value = rig?.leg ?? "";
  for (const input of sizes()) input.value = rig?.[`${input.name}_mm`] ?? "";
  form.elements.hip_sd.value = rig?.hip_height_sd_mm ?? "";
  form.elements.leg_friction.value = [rig?.leg_friction, rig?.leg_friction_sd].filter((number) => number !== undefined).join("±");
  sketch();
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
  const [{ file }] = files, found = await send("answer");
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
  if (event.dataTransfer.files.length) open(event.dataTransfer.files);
});
let adds = false; // to the files that are there
for (const name of ["choose", "add"]) by(name).addEventListener("click", () => { adds = name === "add"; by("file").click(); });
by("file").addEventListener("change", () => { if (by("file").files.length) open([...by("file").files], adds); by("file").value = ""; adds = false; });
by("cancel").addEventListener("click", idle);
form.addEventListener("submit", (event) => { event.preventDefault(); answer(); });
form.addEventListener("change", (event) => {
  const { value, dataset } = event.target;
  by("answer").replaceChildren(); // it was for other choices
  if (dataset.column) take(value, dataset.column);
  if (event.target.closest("#table, #reading") || event.target.name.startsWith("tool")) look();
});
