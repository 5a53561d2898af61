"use strict";
// Colours by name, as the style sheet has them for the theme of the moment.
const COLOUR = /^@([a-z]+)(?:\/([\d.]+))?$/;

// A curve of many; the ramp's ends would vanish into a dark or a light page.
function graded(part) {
  const dark = getComputedStyle(document.documentElement).colorScheme === "dark";
  return ramp(dark ? 0.3 + 0.7 * part : 0.85 * part);
}

function colour(text) {
  if (text.startsWith("ramp:")) return graded(Number(text.slice(5)));
  const found = COLOUR.exec(text);
  if (!found) return text;
  const value = getComputedStyle(document.documentElement).getPropertyValue("--" + found[1]).trim();
  if (!value || !found[2]) return value || text;
  const [r, g, b] = [1, 3, 5].map((i) => parseInt(value.slice(i, i + 2), 16));
  return `rgba(${r},${g},${b},${found[2]})`;
}

function coloured(value) {
  if (typeof value === "string") return colour(value);
  if (Array.isArray(value)) return typeof value[0] === "number" ? value : value.map(coloured);
  if (value && typeof value === "object") {
    return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, coloured(inner)]));
  }
  return value;
}

// Evenly stepped in lightness, told apart by colour-blind readers (viridis at nine places).
const RAMP = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];

function ramp(part) {
  const place = Math.min(Math.max(part, 0), 1) * (RAMP.length - 1);
  const i = Math.min(Math.floor(place), RAMP.length - 2);
  const mix = [1, 3, 5].map((k) => {
    const [a, b] = [RAMP[i], RAMP[i + 1]].map((c) => parseInt(c.slice(k, k + 2), 16));
    return Math.round(a + (b - a) * (place - i));
  });
  return `rgb(${mix})`;
}
const RAMP_COLOURS = Array.from({ length: 64 }, (_, i) => ramp(i / 63));
