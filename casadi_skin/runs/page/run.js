"use strict";
// Linked pictures of a run: a curve, and of the chosen point its wave form, profile, multipliers and their angles.
const PANELS = ["curve", "wave", "plane", "profile", "angles"], MOST_ANGLES = 3000, PAUSE = 250;  // milliseconds
const state = { branch: 0, point: 0, special: null, phase: 0, playing: false, x: data.branches[0].x, y: data.branches[0].y };

const branch = () => data.branches[state.branch];
const known = (name) => data.branches.filter((b) => name in b.columns);

// The place in the details of the point that is nearest to the chosen one.
function detailPlace() {
  const places = branch().detail.point;
  let best = 0;
  places.forEach((p, i) => { if (Math.abs(p - state.point) < Math.abs(places[best] - state.point)) best = i; });
  return best;
}

// A quantity at a place between two points.
function between(values, place) {
  const k = Math.min(Math.floor(place), values.length - 1), part = place - k;
  return part > 0 && values[k + 1] !== null ? values[k] * (1 - part) + values[k + 1] * part : values[k];
}

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
    const marks = [...b.special.map((s, n) => [s.place, s.label, s.kind.startsWith("stability") ? "line-ns" : "diamond", s.point, n]),
      ...b.requested.map((p) => [p, "requested", "circle-open", p, null])];
    traces.push({ x: marks.map((m) => between(x, m[0])), y: marks.map((m) => between(y, m[0])), text: marks.map((m) => m[1]), mode: "markers",
      marker: { symbol: marks.map((m) => m[2]), size: 9, color: colour, line: { width: 1.5, color: colour } }, name: b.name,
      customdata: marks.map((m) => [i, m[3], m[4]]), hovertemplate: "%{text}<br>%{x}<br>%{y}<extra>%{fullData.name}</extra>" });
  });
  return traces;
}

function drawCurve() {
  return react("curve", curveTraces(), { ...layout("branches", named(state.x), named(state.y)), shapes: mark() });
}

// The ring about the chosen point: a shape, which moves without the curves being drawn again.
function mark() {
  const b = branch(), x = b.columns[state.x], y = b.columns[state.y];
  const place = state.special === null ? state.point : b.special[state.special].place;
  const color = getComputedStyle(document.documentElement).getPropertyValue("--chosen");
  if (!x || !y || x[state.point] === null || y[state.point] === null) return [];
  return [{ type: "circle", xsizemode: "pixel", ysizemode: "pixel", xanchor: between(x, place), yanchor: between(y, place),
    x0: -8, x1: 8, y0: -8, y1: 8, line: { width: 3, color } }];
}

function drawPoint() { PARTS.forEach((part) => part()); }

function drawWave() {
  const detail = branch().detail, waves = detail.waves && detail.waves[detailPlace()];
  if (waves) {
    const t = waves[0].map((_, i) => i / (waves[0].length - 1));
    react("wave", waves.map((y, i) => ({ x: t, y, mode: "lines", name: detail.names[i], line: { width: 1.5 } })),
      layout("over one period", "phase t / T", "states"));
  } else react("wave", [], nothing(detail.eigenvalues ? "a state of rest" : "no wave form"));
}

function drawPlane() {
  const detail = branch().detail, k = detailPlace();
  const pairs = detail.multipliers ? detail.multipliers[k] : detail.eigenvalues ? detail.eigenvalues[k] : [];
  const re = pairs.filter((_, i) => i % 2 === 0), im = pairs.filter((_, i) => i % 2 === 1);
  const ring = Array.from({ length: 121 }, (_, i) => (i * Math.PI) / 60);
  const circle = detail.multipliers ? [{ x: ring.map(Math.cos), y: ring.map(Math.sin), mode: "lines", line: { color: "#999", width: 1 }, hoverinfo: "skip" }] : [];
  const title = detail.multipliers ? "Floquet multipliers" : detail.eigenvalues ? "eigenvalues" : "stability not computed";
  react("plane", [...circle, { x: re, y: im, mode: "markers", marker: { size: 8, color: COLOURS[0], symbol: "circle-open", line: { width: 2 } } }],
    layout(title, "real part", "imaginary part", detail.multipliers ? { yaxis: { scaleanchor: "x" } } : {}));
}

// Angles of the multipliers along the branch, with a line at the chosen point.
function drawAngles() {
  const b = branch(), detail = b.detail, x = b.columns[b.x], lists = detail.multipliers || [];
  if (!lists.length) return react("angles", [], nothing(""));
  const xs = [], ys = [], apart = Math.ceil((lists.length * lists[0].length) / 2 / MOST_ANGLES);
  for (let i = 0; i < lists.length; i += apart) {
    const pairs = lists[i];
    for (let j = 0; j + 1 < pairs.length; j += 2) { xs.push(x[detail.point[i]]); ys.push(Math.atan2(pairs[j + 1], pairs[j]) / Math.PI); }
  }
  const base = layout("angles of the multipliers", named(b.x), "angle / \u03c0", { yaxis: { range: [0, 1.02] } });
  return react("angles", [{ x: xs, y: ys, mode: "markers", marker: { size: 3, color: COLOURS[0] } }], { ...base, shapes: line() });
}

function line() {
  const here = branch().columns[branch().x][state.point];
  return [{ type: "line", x0: here, x1: here, yref: "paper", y0: 0, y1: 1, line: { color: COLOURS[1], width: 1.5 } }];
}

function drawProfile() {
  const detail = branch().detail, waves = detail.waves && detail.waves[detailPlace()];
  if (!waves) { react("profile", [], nothing("")); return; }
  const last = waves[0].length - 1, i = Math.floor(state.phase * last) % last;
  const top = Math.max(...waves.flat().map(Math.abs)) || 1;
  react("profile", [{ x: detail.names, y: waves.map((w) => w[i]), mode: "lines+markers", line: { color: COLOURS[2] } }],
    layout("states at one time", "", "", { yaxis: { range: [-1.1 * top, 1.1 * top] } }));
}

// The profile alone, without its axes: fast enough for every frame.
function moveProfile() {
  const detail = branch().detail, waves = detail.waves && detail.waves[detailPlace()];
  if (!waves) return;
  const last = waves[0].length - 1, i = Math.floor(state.phase * last) % last;
  Plotly.animate("profile", { data: [{ y: waves.map((w) => w[i]) }], traces: [0] }, { mode: "immediate", transition: { duration: 0 }, frame: { duration: 0, redraw: false } });
}

function drawValues() {
  const b = branch(), shown = [];
  for (const [name, values] of Object.entries(b.columns)) {
    const error = b.columns[`${name}_error`];
    if (name === "point" || name.endsWith("_error") || shown.length > 7) continue;
    shown.push(`${named(name)} = ${values[state.point]}${error && error[state.point] > 0 ? ` \u00b1 ${Number(error[state.point]).toPrecision(2)}` : ""}`);
  }
  const special = state.special === null ? b.special.find((s) => s.place === state.point) : b.special[state.special];
  const stability = b.stable ? (b.stable[state.point] ? "stable" : "unstable") : "stability not computed";
  const off = b.detail.point[detailPlace()] === state.point ? "" : " (wave form and multipliers of the nearest point kept)";
  element("values").textContent = `${b.name}, point ${b.columns.point[state.point]} of ${b.count}: ${stability}${special ? `, ${special.label}` : ""}; ${special && special.place !== state.point ? "nearest point: " : ""}${shown.join(", ")}${off}`;
}

function select(place, point, special = null) {
  const other = place !== state.branch || !element("branch").options.length;
  state.branch = place;
  state.point = Math.max(0, Math.min(point, branch().columns.point.length - 1));
  state.special = special;
  if (other) list();
  [...element("points").children].forEach((item, n) => item.firstChild.setAttribute("aria-current", n === special));
  anglesToo = anglesToo || other;
  if (!pending) requestAnimationFrame(drawChosen);
  pending = true;
  drawValues();
}

// The branches, and the special points of the chosen one, each a button.
function list() {
  fill(element("branch"), data.branches.map((b) => b.name), branch().name);
  element("points").replaceChildren(...branch().special.map((s, n) => {
    const item = document.createElement("li"), button = document.createElement("button");
    button.type = "button";
    button.textContent = s.label;
    button.addEventListener("click", () => select(state.branch, s.point, n));
    item.append(button);
    return item;
  }));
}

// Keys that come faster than pictures are drawn move the marks alone; the pictures of the point follow when they pause.
// They follow one a frame: together they hold the page for a fifth of a second.
const PARTS = [drawWave, drawPlane, drawProfile];
let pending = false, anglesToo = false, waiting = 0, drawnAt = 0, queue = [];
function drawChosen() {
  if (anglesToo) drawAngles();
  else if (branch().detail.multipliers) Plotly.relayout("angles", { shapes: line() });
  Plotly.relayout("curve", { shapes: mark() });
  clearTimeout(waiting);
  if (performance.now() - drawnAt > PAUSE) drawNow();
  else waiting = setTimeout(drawNow, PAUSE);
  anglesToo = pending = false;
}

function drawNow() {
  waiting = 0;
  drawnAt = performance.now();
  if (!queue.length) requestAnimationFrame(drawPart);
  queue = [...PARTS];
}

function drawPart() {
  queue.shift()();
  if (queue.length) requestAnimationFrame(drawPart);
}

function choose() {
  const names = Object.keys(branch().columns).filter((n) => known(n).length);
  fill(element("x"), names, state.x, named);
  fill(element("y"), names, state.y, named);
}

function step(key) {
  const b = branch();
  if (key === "ArrowRight") select(state.branch, state.point + 1);
  else if (key === "ArrowLeft") select(state.branch, state.point - 1);
  else if (key === "Home") select(state.branch, 0);
  else if (key === "End") select(state.branch, b.columns.point.length - 1);
  else if (key === "ArrowDown") select((state.branch + 1) % data.branches.length, state.point);
  else if (key === "ArrowUp") select((state.branch + data.branches.length - 1) % data.branches.length, state.point);
  else if (key === "s" && b.special.length) {
    const here = state.special === null ? b.special.findIndex((s) => s.place > state.point) : (state.special + 1) % b.special.length;
    select(state.branch, b.special[Math.max(here, 0)].point, Math.max(here, 0));
  }
  else if (key === " ") element("play").click();
  else return false;
  return true;
}

function tick() {
  if (!state.playing) return;
  state.phase = (state.phase + 1 / 96) % 1;
  moveProfile();
  requestAnimationFrame(tick);
}

element("branch").addEventListener("change", (event) => select(event.target.selectedIndex, state.point));
element("x").addEventListener("change", (event) => { state.x = event.target.value; drawCurve(); });
element("y").addEventListener("change", (event) => { state.y = event.target.value; drawCurve(); });
element("play").addEventListener("click", () => {
  state.playing = !state.playing;
  element("play").textContent = state.playing ? "pause" : "play";
  tick();
});

prepare(() => { drawCurve(); drawAngles(); drawPoint(); }, step);
choose();
Promise.all([drawCurve(), drawAngles()]).then(() => {
  select(0, 0);
  element("curve").on("plotly_click", (event) => {
    const chosen = event.points.find((p) => p.customdata);
    if (chosen) select(chosen.customdata[0], chosen.customdata[1], chosen.customdata[2] ?? null);
  });
  ready(PANELS);
});
