// Unpacks plotly, draws everything, and draws it again when the theme changes.
const root = document.documentElement;
const { drawings } = JSON.parse(document.getElementById("data").textContent);
const players = {};
const CONFIG = {
  responsive: true,
  displaylogo: false,
  // On a phone its buttons would cover the legend, and a finger has gestures for the same.
  displayModeBar: matchMedia("(pointer: coarse)").matches ? false : "hover",
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "zoomIn2d", "zoomOut2d"],
};

async function inflated(text) {
  const packed = new Blob([bytes(text)]).stream();
  return new Response(packed.pipeThrough(new DecompressionStream("gzip"))).text();
}

function axis(own) {
  return {
    automargin: true, gridcolor: "@line", zerolinecolor: "@grey", linecolor: "@line",
    ticks: "outside", tickcolor: "@line", ...own,
    title: { standoff: 8, ...(own.title || {}) },
  };
}

let printing = false;

function finished(layout, name) {
  const axes = { xaxis: {}, yaxis: {}, ...layout };
  const shared = {
    font: { family: getComputedStyle(document.body).fontFamily, size: printing ? 10 : 12, color: "@ink" },
    paper_bgcolor: "@paper", plot_bgcolor: "@paper",
    margin: { l: 50, r: 12, t: 12, b: 40 },
    hovermode: "closest",
    hoverlabel: { bgcolor: "@card", bordercolor: "@line", font: { color: "@ink" } },
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
    // A finger on a plot scrolls the page.
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
  };
  const whole = { ...shared, ...layout };
  const place = document.getElementById(name);
  if (printing) Object.assign(whole, { width: place.clientWidth, height: place.clientHeight });
  for (const name of Object.keys(axes)) if (/^[xy]axis\d*$/.test(name)) whole[name] = axis(axes[name]);
  return coloured(whole);
}

function draw(name) {
  const { traces, layout } = drawings[name];
  return Plotly.react(name, coloured(traces), finished(layout, name), CONFIG);
}

const plots = Object.keys(drawings).filter((name) => drawings[name].traces);

function redraw() {
  plots.forEach(draw);
  Object.values(players).forEach((player) => player.show(player.frame));
}

function follower(name) {
  const beside = plots.filter((plot) => drawings[plot].follows === name);
  return (at) => {
    for (const plot of beside) {
      const place = document.getElementById(plot);
      if (place.layout) Plotly.relayout(place, { "shapes[0].x0": at, "shapes[0].x1": at });
    }
  };
}

function themed() {
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.getElementById("theme").setAttribute("aria-pressed", String(dark));
  return dark;
}

function setTheme(theme) {
  if (theme) root.dataset.theme = theme;
  else delete root.dataset.theme;
  themed();
  redraw();
}

function listen() {
  document.getElementById("theme").addEventListener("click", () => setTheme(themed() ? "light" : "dark"));
  document.getElementById("print").addEventListener("click", () => window.print());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { themed(); redraw(); });
  // What the reader unfolded is printed, on white, and plots are as wide as their place on paper.
  let before;
  window.addEventListener("beforeprint", () => {
    before = root.dataset.theme;
    printing = true;
    root.classList.add("printing");
    setTheme("light");
  });
  window.addEventListener("afterprint", () => {
    printing = false;
    root.classList.remove("printing");
    setTheme(before);
  });
}

(async () => {
  try {
    const script = document.createElement("script");
    script.textContent = await inflated(document.getElementById("plotly").textContent);
    document.head.append(script);
    await Promise.all(plots.map(draw));
    for (const name of Object.keys(drawings)) {
      if (drawings[name].player) players[name] = new Player(document.getElementById(name), drawings[name].player, follower(name));
    }
    listen();
    themed();
    root.dataset.drawn = String(plots.length);
  } catch (error) {
    const trouble = document.getElementById("trouble");
    trouble.textContent = "The plots could not be drawn; a browser of 2023 or later is needed.";
    trouble.hidden = false;
    console.error(error);
  }
})();
