"use strict";
// What pages of runs and of maps share: data, colours, layouts, words, light and dark.
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c564b", "#7f7f7f"];
let dark = window.matchMedia("(prefers-color-scheme: dark)").matches;

function layout(title, x, y, more = {}) {
  const style = getComputedStyle(document.documentElement);
  const ink = style.getPropertyValue("--ink"), line = style.getPropertyValue("--line"), paper = style.getPropertyValue("--paper");
  const axis = (words) => ({ title: { text: words }, gridcolor: line, zerolinecolor: line, linecolor: line, exponentformat: "power" });
  const base = { title: { text: title, font: { size: 15 }, x: 0.03, xanchor: "left" }, paper_bgcolor: paper, plot_bgcolor: paper, font: { color: ink, size: 14 },
    margin: { l: 62, r: 12, t: 34, b: 46 }, showlegend: false, xaxis: axis(x), yaxis: axis(y), hovermode: "closest", uirevision: title + x + y };
  for (const [name, value] of Object.entries(more)) base[name] = { ...(base[name] || {}), ...value };
  return base;
}
const nothing = (words) => layout(words, "", "", { xaxis: { visible: false }, yaxis: { visible: false } });
const config = { responsive: true, displaylogo: false, scrollZoom: true };

// Names are text: plotly takes tags in them for marks, and would fetch what a style in one names.
function asText(value, key) {
  if (typeof value === "string") return key === "hovertemplate" ? value : value.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
  if (Array.isArray(value)) return value.map((item) => asText(item));
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([name, held]) => [name, asText(held, name)]));
}
const react = (id, traces, lay) => Plotly.react(id, asText(traces), asText(lay), config);

const words = { S: "amplitude S", Omega: "frequency \u03a9", Omega_shift: "frequency shift \u03a9 \u2212 \u03c9" };
const named = (name) => (Object.hasOwn(words, name) && words[name]) || name.replaceAll("_", " ");

function fill(select, names, chosen, label = (n) => n) {
  select.replaceChildren(...names.map((name) => new Option(label(name), name, false, name === chosen)));
}

function themed() { document.documentElement.classList.toggle("dark", dark); document.documentElement.style.colorScheme = dark ? "dark" : "light"; }

// Colours and keys of a page: `draw` draws all again, `step` answers whether it took a key.
function prepare(draw, step) {
  element("theme").addEventListener("click", () => { dark = !dark; themed(); draw(); });
  document.addEventListener("keydown", (event) => {
    if (["SELECT", "INPUT"].includes(document.activeElement.tagName)) return;
    if (document.activeElement.tagName === "BUTTON" && [" ", "Enter"].includes(event.key)) return;
    if (!event.ctrlKey && !event.metaKey && !event.altKey && step(event.key)) event.preventDefault();
  });
  themed();
  element("note").textContent = data.note;
}

// Called once all pictures are there: they follow the size of the window.
function ready(panels) {
  new ResizeObserver(() => panels.forEach((id) => Plotly.Plots.resize(id))).observe(document.querySelector("main"));
  document.documentElement.dataset.ready = "yes";
}
