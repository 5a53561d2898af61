const by = (id) => document.getElementById(id);
const form = by("form");
const token = new URLSearchParams(location.search).get("token");
const roles = JSON.parse(by("roles").textContent);
let files = [], shown, chosen = {}, busy = 0, running, ofTool = "", pressed = false;

function create(tag, properties, ...inside) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...inside);
  return element;
}

// -- talking to the server ---------------------------------------------------------------------

const isToml = ({ file }) => /\.toml$/i.test(file.name);
const body = (entry) => entry?.body.trim() || form.elements.tool.value.trim();
const tool = () => (body(shown).includes(":") ? body(shown) : "");

// A name may have a comma, and an equals sign.
const pairs = (text) => text.split(/,(?=\s*\w+\s*=)/).filter((pair) => pair.includes("=")).map((pair) => pair.match(/^([^=]*)=(.*)$/s).slice(1).map((part) => part.trim()));
const toolColumns = () => Object.fromEntries(pairs(form.elements.tool_columns.value));

function columns(task) {
  if (task === "look" ? tool() : form.elements.tool.value.trim()) return toolColumns();
  const choices = { ...chosen };
  // Of several files each is guessed by itself, but for what was chosen.
  const guessed = task === "answer" && files.length > 1 ? [] : document.querySelectorAll("#table select");
  for (const { value, dataset } of guessed) if (value) choices[value] = dataset.column;
  for (const { name, value } of by("reading").querySelectorAll("[name]")) {
    if (value) choices[name] = value === "true" || (Number.isNaN(Number(value)) ? value : Number(value));
  }
  return choices;
}

function idle() {
  running?.abort();
  by("status").hidden = true;
  return ++busy;
}

// The reply, refused or not; null where something newer was asked, or it was cancelled.
async function send(task, entries = files) {
  const turn = idle(), began = Date.now(), most = Number(by("drop").dataset.megabytes);
  if (entries.reduce((sum, { file }) => sum + file.size, 0) > 1e6 * most) {
    const refused = `${entries.map(({ file }) => file.name).join(", ")}: larger than ${most} MB; use the command line.`;
    alarm(refused);
    return { refused };
  }
  let stage = task === "look" ? "Reading" : "Working";
  running = new AbortController();
  const tell = () => { by("stage").textContent = `${stage}: ${Math.round((Date.now() - began) / 1000)} s`; };
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
  let text = "", reply = { refused: "The files did not arrive: they may be too large, or the app has been stopped." };
  try {
    const response = await fetch(`/${task}?${address}`, {
      method: "POST", body: new Blob(entries.map(({ file }) => file)), headers: { "x-terraphi": token }, signal: running.signal,
    });
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      const lines = (text + part.value).split("\n");
      text = lines.pop();
      for (const line of lines) ({ stage } = JSON.parse(line));
    }
    reply = JSON.parse(text);
  } catch { /* as it is */ } finally {
    clearInterval(tick);
  }
  if (turn !== busy) return null;
  idle();
  if (reply.refused || !isToml(entries[0])) alarm(reply.refused || reply.wrong); // a sound TOML keeps the warning of the forces
  return reply;
}

// -- what is wrong, and what would help ---------------------------------------------------------

const OFFER = /[,;]?\s*(?:add|or)?\s*--(columns|leg) (?:'([^']*)'|([\w=.,-]*(?:\w\b|%)))(?! --)/g;

function offers(text) {
  const values = [...text.matchAll(OFFER)].map(([, option, quoted, plain]) => [option, quoted ?? plain]);
  return values.filter(([, value]) => !/=(NAME|UNIT)/.test(value)).map(([option, value]) => create("button", {
    type: "button", textContent: `Use ${option === "leg" ? "leg " : ""}${value}`, onclick: () => apply(option, value),
  }));
}

function alarm(text) {
  by("alert").hidden = !text;
  if (!text) return;
  by("alert").replaceChildren(text.replace(OFFER, ""));
  by("alert").append(create("div", {}, ...offers(text)));
  by("alert").scrollIntoView({ block: "nearest" });
}

// Of a tool the field with its columns has the choices.
function take(role, column) {
  if (ofTool) {
    const kept = Object.entries(toolColumns()).filter(([key, name]) => key !== role && name !== column);
    form.elements.tool_columns.value = [...kept, ...(role ? [[role, column]] : [])].map((pair) => pair.join("=")).join(",");
  } else {
    for (const key of Object.keys(chosen)) if (chosen[key] === column) delete chosen[key];
    if (role) chosen[role] = column;
  }
  for (const select of document.querySelectorAll("#table select")) {
    if (select.dataset.column === column) select.value = role;
    else if (role && select.value === role) select.value = "";
  }
}

function apply(option, value) {
  if (option === "leg") form.elements.leg.value = value;
  else for (const [key, text] of pairs(value)) {
    if (ofTool) form.elements.tool_columns.value += `${form.elements.tool_columns.value && ","}${key}=${text}`;
    else if (key in roles) take(key, text);
    else if (form.elements[key]) form.elements[key].value = text;
  }
  if (option === "leg" || (by("answer").childElementCount && form.checkValidity())) answer();
  else look();
}

// -- a preview -----------------------------------------------------------------------------------

function tabulate({ columns, units, rows, roles: guessed, candidates, of_tool: ofTool }) {
  const choices = ofTool ? Object.fromEntries(ofTool.map((role) => [role, role.replace("_", " ")])) : roles;
  const taken = ofTool ? toolColumns() : guessed;
  const head = columns.map((name, i) => {
    const select = create("select", { ariaLabel: `What ${name} is` }, create("option", { value: "", textContent: ofTool ? "as guessed" : "not used" }));
    for (const [role, text] of Object.entries(choices)) select.append(create("option", { value: role, textContent: text }));
    select.dataset.column = name;
    select.value = Object.keys(taken).find((role) => taken[role] === name) || "";
    if (!ofTool && !taken.theta && !candidates.theta?.length && candidates.time?.[0] === name) { select.value = "time"; chosen.time = name; }
    return create("th", { scope: "col" }, select, create("div", {}, name), create("div", { className: "note", textContent: units[i] || "no unit" }));
  });
  const body = rows.map((row) => create("tr", {}, ...row.map((cell) => create("td", { className: "short", textContent: cell ?? "" }))));
  by("table").replaceChildren(create("thead", {}, create("tr", {}, ...head)), create("tbody", {}, ...body));
}

const ask = (...inside) => create("div", { className: "question" }, ...inside);

function show(reply) {
  by("read").replaceChildren(...(reply.read || []).map((text) => create("div", {}, text)));
  by("picture").hidden = !reply.picture;
  if (reply.picture) by("picture").src = reply.picture;
  by("questions").replaceChildren();
  if (reply.of_tool && !tool()) {
    by("questions").replaceChildren(ask("Is this of a plate, a ball or a wheel? Enter its sizes below."));
    alarm("");
  }
  if (reply.of_tool) return;
  const taken = columns("look"), questions = [], lacking = [];
  for (const [role, text] of Object.entries(roles)) {
    const names = (reply.candidates[role] || []).filter((name) => !Object.values(taken).includes(name));
    if (taken[role] || role === "time" || (role === "theta" && taken.time)) continue;
    const buttons = names.map((name) => create("button", { type: "button", textContent: name, onclick: () => { take(role, name); look(); } }));
    if (names.length > 1) questions.push(ask(`Which column is the ${text}? `, ...buttons));
    else if (role !== "moment") lacking.push(text);
  }
  if (lacking.length && reply.wrong) {
    questions.push(ask(`Which column is the ${lacking.join(", which the ")}? Choose above the table. `, ...offers(reply.wrong)));
  }
  if (taken.time && !taken.theta && !taken.rate_deg_s) {
    questions.push(ask("There is a time and no angle. Enter the rate of the leg, and the angle at time 0 as what is added to the angle."));
  }
  for (const [role, name, usual] of [["theta", "theta_unit", "deg"], ["fz", "unit", "N"]]) {
    const unit = reply.units[reply.columns.indexOf(taken[role])];
    form.elements[name].options[0].text = unit ? `${unit} (header)` : usual;
  }
  by("questions").replaceChildren(...questions);
  if (questions.length) alarm("");
}

// A tool has no leg, and other roles of columns.
function arrange() {
  const isTool = Boolean(form.elements.tool.value.trim());
  for (const part of [by("reading"), by("rig")]) part.hidden = part.disabled = isTool;
}

async function preview() {
  arrange();
  const reply = await send("look", [shown]);
  if (reply?.kind === "forces") {
    if (String(reply.of_tool ?? "") !== ofTool) tabulate(reply);
    ofTool = String(reply.of_tool ?? "");
    show(reply);
  }
  return reply;
}

const look = async () => await preview() && readTomls();

// A rig fills the form and leaves the list. A read that was cut short is made up before an answer.
async function readTomls() {
  for (const entry of files.filter((other) => isToml(other) && !other.kind)) {
    const reply = await send("look", [entry]);
    if (!reply) return false;
    entry.kind = reply.kind ?? "cannot be read";
    if (reply.kind === "rig") { fill(reply.rig); files = files.filter((other) => other !== entry); }
    list();
  }
  return true;
}

// Names of all files: a press shows one of them, a body of its own is a leg or a tool.
function list() {
  by("files").replaceChildren(...files.map((entry) => create("li", {},
    create("button", { type: "button", textContent: entry.file.name, ariaPressed: String(entry === shown), disabled: isToml(entry), onclick: () => display(entry) }),
    isToml(entry) ? entry.kind ?? "not read yet" : create("input", { value: entry.body, placeholder: "leg or tool as below", ariaLabel: `Leg or tool of ${entry.file.name}`, onchange: ({ target }) => { entry.body = target.value; display(entry); } }),
    create("button", { type: "button", textContent: "×", ariaLabel: `Leave out ${entry.file.name}`, onclick: () => leaveOut(entry) }),
  )));
  for (const input of by("files").querySelectorAll("input")) input.setAttribute("list", "bodies");
}

function leaveOut(entry) {
  by("answer").replaceChildren(); // it was for all files
  files = files.filter((other) => other !== entry);
  if (files.every(isToml)) { idle(); form.hidden = true; } else display(entry === shown ? files[0] : shown);
}

// The first rows of a file, and what was read.
async function display(entry) {
  if (entry !== shown) by("table").replaceChildren();
  shown = entry;
  list();
  const reply = await preview();
  if (reply?.columns) { tabulate(reply); show(reply); }
  if (reply) await readTomls();
}

function open(dropped, more) {
  const added = [...dropped].map((file) => ({ file, body: "" })), tables = added.filter((entry) => !isToml(entry));
  const replaces = form.hidden || !(more || !tables.length);
  if (replaces && !tables.length) { alarm("Choose the forces as well: a rig or a calibration goes with them."); return; }
  by("answer").replaceChildren();
  files = [...(replaces ? [] : files), ...added].sort((a, b) => isToml(a) - isToml(b));
  if (replaces) begin();
  else if (tables.length) display(tables[0]);
  else { list(); readTomls(); }
}

// The first of new files decides what the form asks for; what needs no choice is answered at once.
async function begin() {
  form.reset();
  form.hidden = true;
  by("table").replaceChildren();
  [chosen, shown] = [{}, files[0]];
  list();
  const reply = await preview(), kind = reply?.kind;
  if (!kind) return;
  form.hidden = !["forces", "log"].includes(kind);
  by("forces").hidden = by("forces").inert = kind !== "forces";
  by("robot").hidden = kind !== "log";
  for (const label of document.querySelectorAll(".of-forces")) label.hidden = kind !== "forces";
  form.noValidate = kind !== "forces"; // what is hidden is required of forces alone
  if (kind !== "forces") { answer(); return; }
  tabulate(reply);
  fill(reply.rig);
  form.elements.tool.value = reply.tool ?? "";
  if (reply.density) form.elements.density.value = reply.density;
  show(reply);
  by("table").querySelector("select").focus({ preventScroll: true });
  if (reply.tool) look();
  else readTomls();
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
    const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    by("drawing").append(element);
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
  const reply = await readTomls() && await send("answer");
  if (!reply?.html) return;
  const prefix = files.length > 1 ? "" : files[0].file.name.replace(/(\.[^.]*)?$/, "-");
  const links = Object.entries(reply.files).map(([name, content]) => {
    const blob = new Blob([Uint8Array.from(atob(content), (c) => c.charCodeAt(0))]);
    return create("a", { href: URL.createObjectURL(blob), download: prefix + name, textContent: name });
  });
  by("answer").innerHTML = reply.html;
  const box = by("answer").querySelector(".answer");
  box.append(create("p", { className: "offers" }, ...offers(box.textContent)));
  box.append(create("p", {}, "Download: ", ...links.flatMap((link, i) => (i ? [", ", link] : [link]))));
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
// A field that was edited changes as the button is pressed. What it hides would move the button away
// from under the pointer, and the answer reads the file anyhow.
by("find").addEventListener("pointerdown", () => { pressed = true; });
for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, () => { pressed = false; });
by("find").addEventListener("click", arrange); // before the form is checked
form.addEventListener("submit", (event) => { event.preventDefault(); answer(); });
form.addEventListener("change", (event) => {
  const { value, dataset } = event.target;
  by("answer").replaceChildren(); // it was for other choices
  if (dataset.column) take(value, dataset.column);
  if (!pressed && (event.target.closest("#table, #reading") || event.target.name.startsWith("tool"))) look();
});
