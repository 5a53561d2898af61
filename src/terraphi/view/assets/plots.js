"use strict";
// A finger on a plot scrolls the page.
const coarse = matchMedia("(pointer: coarse)").matches;

let unpacked;

async function unpack() {
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const library = document.createElement("script");
  library.textContent = await new Response(stream).text();
  document.head.append(library);
}

async function draw(plots) {
  await (unpacked ??= unpack());
  const axis = { automargin: true, gridcolor: "#e3e6ea", zerolinecolor: "#9aa4af" };
  for (const [id, { data, layout }] of Object.entries(plots)) {
    await Plotly.newPlot(id, data, {
      font: { size: 12 }, margin: { l: 50, r: 12, t: 30, b: 40 }, hovermode: "closest",
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" }, dragmode: coarse ? false : "zoom",
      ...layout, xaxis: { ...axis, ...layout.xaxis }, yaxis: { ...axis, ...layout.yaxis },
    }, { responsive: true, displayModeBar: false });
  }
  document.documentElement.dataset.drawn = Object.keys(plots).length;
}
