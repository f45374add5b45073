"use strict";
// Linked pictures of a run: a curve, and of the chosen point its wave form, profile, multipliers and their angles.
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c564b", "#7f7f7f"];
const PANELS = ["curve", "wave", "plane", "profile", "angles"], MOST_ANGLES = 3000;
const state = { branch: 0, point: 0, phase: 0, playing: false, x: data.branches[0].x, y: data.branches[0].y };
let dark = window.matchMedia("(prefers-color-scheme: dark)").matches;

const branch = () => data.branches[state.branch];
const known = (name) => data.branches.filter((b) => name in b.columns);

// The place in the details of the point that is nearest to the chosen one.
function detailPlace() {
  const places = branch().detail.point;
  let best = 0;
  places.forEach((p, i) => { if (Math.abs(p - state.point) < Math.abs(places[best] - state.point)) best = i; });
  return best;
}

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

// Curves: stable stretches solid, unstable ones dashed; neighbours share the point between them.
function curveTraces() {
  const traces = [];
  data.branches.forEach((b, i) => {
    const x = b.columns[state.x], y = b.columns[state.y];
    if (!x || !y) return;
    const colour = COLOURS[i % COLOURS.length];
    for (const [stable, dash, word] of [[1, "solid", "stable"], [0, "dash", "unstable"]]) {
      const shown = (k) => !b.stable ? stable === 1 : b.stable[k] === stable || (k > 0 && b.stable[k - 1] === stable);
      traces.push({ x, y: y.map((v, k) => (shown(k) ? v : null)), mode: "lines", line: { color: colour, dash, width: 2.5 },
        name: `${b.name}, ${b.stable ? word : "stability not computed"}`, customdata: x.map((_, k) => [i, k]), connectgaps: false });
    }
    const marks = [...b.special.map((s) => [s.point, s.kind, "diamond"]), ...b.requested.map((p) => [p, "requested", "circle-open"])];
    traces.push({ x: marks.map((m) => x[m[0]]), y: marks.map((m) => y[m[0]]), text: marks.map((m) => m[1]), mode: "markers",
      marker: { symbol: marks.map((m) => m[2]), size: 9, color: colour, line: { width: 1 } }, name: b.name,
      customdata: marks.map((m) => [i, m[0]]), hovertemplate: "%{text}<br>%{x}<br>%{y}<extra>%{fullData.name}</extra>" });
  });
  return traces;
}

const words = { S: "amplitude S", Omega: "frequency \u03a9", Omega_shift: "frequency shift \u03a9 \u2212 \u03c9" };
const named = (name) => words[name] || name.replaceAll("_", " ");

function drawCurve() {
  return Plotly.react("curve", curveTraces(), { ...layout("branches", named(state.x), named(state.y)), shapes: mark() }, config);
}

// The ring about the chosen point: a shape, which moves without the curves being drawn again.
function mark() {
  const b = branch(), x = b.columns[state.x], y = b.columns[state.y];
  const color = getComputedStyle(document.documentElement).getPropertyValue("--chosen");
  if (!x || !y || x[state.point] === null || y[state.point] === null) return [];
  return [{ type: "circle", xsizemode: "pixel", ysizemode: "pixel", xanchor: x[state.point], yanchor: y[state.point],
    x0: -8, x1: 8, y0: -8, y1: 8, line: { width: 3, color } }];
}

function drawPoint() {
  const b = branch(), k = detailPlace(), detail = b.detail, waves = detail.waves && detail.waves[k];
  if (waves) {
    const t = waves[0].map((_, i) => i / (waves[0].length - 1));
    Plotly.react("wave", waves.map((y, i) => ({ x: t, y, mode: "lines", name: detail.names[i], line: { width: 1.5 } })),
      layout("over one period", "phase t / T", "states"), config);
  } else Plotly.react("wave", [], nothing(detail.eigenvalues ? "a state of rest" : "no wave form"), config);
  drawProfile();
  const pairs = detail.multipliers ? detail.multipliers[k] : detail.eigenvalues ? detail.eigenvalues[k] : [];
  const re = pairs.filter((_, i) => i % 2 === 0), im = pairs.filter((_, i) => i % 2 === 1);
  const ring = Array.from({ length: 121 }, (_, i) => (i * Math.PI) / 60);
  const circle = detail.multipliers ? [{ x: ring.map(Math.cos), y: ring.map(Math.sin), mode: "lines", line: { color: "#999", width: 1 }, hoverinfo: "skip" }] : [];
  const title = detail.multipliers ? "Floquet multipliers" : detail.eigenvalues ? "eigenvalues" : "stability not computed";
  Plotly.react("plane", [...circle, { x: re, y: im, mode: "markers", marker: { size: 8, color: COLOURS[0], symbol: "circle-open", line: { width: 2 } } }],
    layout(title, "real part", "imaginary part", detail.multipliers ? { yaxis: { scaleanchor: "x" } } : {}), config);
}

// Angles of the multipliers along the branch, with a line at the chosen point.
function drawAngles() {
  const b = branch(), detail = b.detail, x = b.columns[b.x], lists = detail.multipliers || [];
  if (!lists.length) return Plotly.react("angles", [], nothing(""), config);
  const xs = [], ys = [], apart = Math.ceil((lists.length * lists[0].length) / 2 / MOST_ANGLES);
  for (let i = 0; i < lists.length; i += apart) {
    const pairs = lists[i];
    for (let j = 0; j + 1 < pairs.length; j += 2) { xs.push(x[detail.point[i]]); ys.push(Math.atan2(pairs[j + 1], pairs[j]) / Math.PI); }
  }
  const base = layout("angles of the multipliers", named(b.x), "angle / \u03c0", { yaxis: { range: [0, 1.02] } });
  return Plotly.react("angles", [{ x: xs, y: ys, mode: "markers", marker: { size: 3, color: COLOURS[0] } }], { ...base, shapes: line() }, config);
}

function line() {
  const here = branch().columns[branch().x][state.point];
  return [{ type: "line", x0: here, x1: here, yref: "paper", y0: 0, y1: 1, line: { color: COLOURS[1], width: 1.5 } }];
}

function drawProfile() {
  const detail = branch().detail, waves = detail.waves && detail.waves[detailPlace()];
  if (!waves) { Plotly.react("profile", [], nothing(""), config); return; }
  const last = waves[0].length - 1, i = Math.floor(state.phase * last) % last;
  const top = Math.max(...waves.flat().map(Math.abs)) || 1;
  Plotly.react("profile", [{ x: detail.names, y: waves.map((w) => w[i]), mode: "lines+markers", line: { color: COLOURS[2] } }],
    layout("states at one time", "", "", { yaxis: { range: [-1.1 * top, 1.1 * top] } }), config);
}

function drawValues() {
  const b = branch(), shown = [];
  for (const [name, values] of Object.entries(b.columns)) {
    const error = b.columns[`${name}_error`];
    if (name === "point" || name.endsWith("_error") || shown.length > 7) continue;
    shown.push(`${named(name)} = ${values[state.point]}${error && error[state.point] > 0 ? ` \u00b1 ${Number(error[state.point]).toPrecision(2)}` : ""}`);
  }
  const special = b.special.find((s) => s.point === state.point);
  const stability = b.stable ? (b.stable[state.point] ? "stable" : "unstable") : "stability not computed";
  const off = b.detail.point[detailPlace()] === state.point ? "" : " (wave form and multipliers of the nearest point kept)";
  element("values").textContent = `${b.name}, point ${b.columns.point[state.point]} of ${b.count}: ${stability}${special ? `, ${special.kind}` : ""}; ${shown.join(", ")}${off}`;
}

function fill(select, names, chosen, label = (n) => n) {
  select.replaceChildren(...names.map((name) => new Option(label(name), name, false, name === chosen)));
}

function select(place, point) {
  const other = place !== state.branch;
  state.branch = place;
  state.point = Math.max(0, Math.min(point, branch().columns.point.length - 1));
  if (other || !element("branch").options.length) {
    fill(element("branch"), data.branches.map((b) => b.name), branch().name);
    const special = branch().special;
    element("special").replaceChildren(new Option(special.length ? "choose" : "none", ""), ...special.map((s) => {
      const value = branch().columns[branch().x][s.point];
      return new Option(`${s.kind} at ${named(branch().x)} = ${value}`, s.point);
    }));
  }
  anglesToo = anglesToo || other;
  if (!pending) requestAnimationFrame(drawChosen);
  pending = true;
  drawValues();
}

// Keys that come faster than pictures are drawn once.
let pending = false, anglesToo = false;
function drawChosen() {
  drawPoint();
  if (anglesToo) drawAngles();
  else if (branch().detail.multipliers) Plotly.relayout("angles", { shapes: line() });
  Plotly.relayout("curve", { shapes: mark() });
  pending = anglesToo = false;
}

function choose() {
  const names = Object.keys(branch().columns).filter((n) => known(n).length);
  fill(element("x"), names, state.x, named);
  fill(element("y"), names, state.y, named);
}

function step(key) {
  const b = branch(), special = b.special.map((s) => s.point);
  if (key === "ArrowRight") select(state.branch, state.point + 1);
  else if (key === "ArrowLeft") select(state.branch, state.point - 1);
  else if (key === "Home") select(state.branch, 0);
  else if (key === "End") select(state.branch, b.columns.point.length - 1);
  else if (key === "ArrowDown") select((state.branch + 1) % data.branches.length, state.point);
  else if (key === "ArrowUp") select((state.branch + data.branches.length - 1) % data.branches.length, state.point);
  else if (key === "s") select(state.branch, special.find((p) => p > state.point) ?? special[0] ?? state.point);
  else if (key === " ") element("play").click();
  else return false;
  return true;
}

function tick() {
  if (!state.playing) return;
  state.phase = (state.phase + 1 / 96) % 1;
  drawProfile();
  requestAnimationFrame(tick);
}

element("branch").addEventListener("change", (event) => select(event.target.selectedIndex, state.point));
element("x").addEventListener("change", (event) => { state.x = event.target.value; drawCurve(); });
element("y").addEventListener("change", (event) => { state.y = event.target.value; drawCurve(); });
element("special").addEventListener("change", (event) => { if (event.target.value !== "") select(state.branch, Number(event.target.value)); });
element("play").addEventListener("click", () => {
  state.playing = !state.playing;
  element("play").textContent = state.playing ? "pause" : "play";
  tick();
});
function themed() { document.documentElement.classList.toggle("dark", dark); document.documentElement.style.colorScheme = dark ? "dark" : "light"; }
element("theme").addEventListener("click", () => { dark = !dark; themed(); drawCurve(); drawAngles(); drawPoint(); });
document.addEventListener("keydown", (event) => {
  if (["SELECT", "BUTTON", "INPUT"].includes(document.activeElement.tagName) && event.key !== "s") return;
  if (!event.ctrlKey && !event.metaKey && !event.altKey && step(event.key)) event.preventDefault();
});

themed();
element("note").textContent = data.note;
choose();
Promise.all([drawCurve(), drawAngles()]).then(() => {
  select(0, 0);
  new ResizeObserver(() => PANELS.forEach((id) => Plotly.Plots.resize(id))).observe(document.querySelector("main"));
  element("curve").on("plotly_click", (event) => {
    const chosen = event.points.find((p) => p.customdata);
    if (chosen) select(chosen.customdata[0], chosen.customdata[1]);
  });
  document.documentElement.dataset.ready = "yes";
});
