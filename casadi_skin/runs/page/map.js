"use strict";
// A map: one quantity in the plane of two axes, and through the chosen cell along each of them.
const axes = data.axes, sizes = axes.map((a) => a.values.length), strides = sizes.map((_, i) => sizes.slice(i + 1).reduce((p, n) => p * n, 1));
const plain = axes.map((_, i) => i).filter((i) => sizes[i] > 1).sort((i, j) => axes[j].numbers - axes[i].numbers);
const state = { quantity: 0, x: plain[0] ?? 0, y: plain[1] ?? null, cell: sizes.map(() => 0) };
const SHADES = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];  // viridis
const place = (cell) => cell.reduce((sum, k, i) => sum + k * strides[i], 0);
const values = () => data.quantities[state.quantity].values;
const at = (changes) => place(state.cell.map((k, i) => changes[i] ?? k));

function shade(part) {
  const s = Math.min(Math.max(part, 0), 1) * (SHADES.length - 1), k = Math.min(Math.floor(s), SHADES.length - 2);
  return SHADES[k].map((c, i) => Math.round(c + (s - k) * (SHADES[k + 1][i] - c)));
}

function range() {
  const known = values().filter((v) => v !== null);
  const low = known.reduce((a, v) => Math.min(a, v), Infinity), high = known.reduce((a, v) => Math.max(a, v), -Infinity);
  return [low, high > low ? high : low + 1];
}

// Ends of the cells along an axis: halfway between values, by number where they are words.
function ends(axis) {
  const v = axis.numbers ? axis.values : axis.values.map((_, k) => k);
  if (v.length < 2) return [v[0] - 0.5, v[0] + 0.5];
  const middle = v.slice(1).map((w, k) => (w + v[k]) / 2);
  return [2 * v[0] - middle[0], ...middle, 2 * v[v.length - 1] - middle[middle.length - 1]];
}

function nearest(axis, value) {
  const edge = ends(axis), k = edge.findIndex((_, i) => i + 1 < edge.length && (value - edge[i]) * (value - edge[i + 1]) <= 0);
  return k < 0 ? null : k;
}

// One pixel a cell where the values are even, else as many as the finest cell asks for.
function picture() {
  const ex = ends(axes[state.x]), ey = state.y === null ? [0, 1] : ends(axes[state.y]);
  const fine = (e) => Math.min(Math.max(Math.round((e[e.length - 1] - e[0]) / Math.min(...e.slice(1).map((v, k) => Math.abs(v - e[k]))) * Math.sign(e[e.length - 1] - e[0])), e.length - 1), 600);
  const w = fine(ex), h = fine(ey), canvas = document.createElement("canvas"), [low, high] = range(), all = values();
  canvas.width = w; canvas.height = h;
  const ink = canvas.getContext("2d"), pixels = ink.createImageData(w, h);
  const cellOf = (e, n) => { let k = 0; return Array.from({ length: n }, (_, i) => { const v = e[0] + ((i + 0.5) / n) * (e[e.length - 1] - e[0]); while (k + 2 < e.length && (v - e[k + 1]) * (e[k + 1] - e[0]) > 0) k += 1; return k; }); };
  const kx = cellOf(ex, w), ky = cellOf(ey, h);
  for (let j = 0; j < h; j += 1) for (let i = 0; i < w; i += 1) {
    const changes = { [state.x]: kx[i] };
    if (state.y !== null) changes[state.y] = ky[h - 1 - j];
    const v = all[at(changes)];
    if (v !== null) pixels.data.set([...shade((v - low) / (high - low)), 255], 4 * (j * w + i));
  }
  ink.putImageData(pixels, 0, 0);
  return { url: canvas.toDataURL(), ex, ey };
}

function ticks(axis) {
  return axis.numbers ? {} : { tickmode: "array", tickvals: axis.values.map((_, k) => k), ticktext: axis.values };
}
const coordinate = (i) => (axes[i].numbers ? axes[i].values[state.cell[i]] : state.cell[i]);

function ring() {
  const color = getComputedStyle(document.documentElement).getPropertyValue("--chosen");
  return [{ type: "circle", xsizemode: "pixel", ysizemode: "pixel", xanchor: coordinate(state.x), yanchor: state.y === null ? 0.5 : coordinate(state.y),
    x0: -8, x1: 8, y0: -8, y1: 8, line: { width: 3, color } }];
}

function drawPlane() {
  const { url, ex, ey } = picture(), [low, high] = range(), q = data.quantities[state.quantity];
  const corners = { x: [ex[0], ex[ex.length - 1]], y: [ey[0], ey[ey.length - 1]] };
  const scale = SHADES.map((c, i) => [i / (SHADES.length - 1), `rgb(${c.join(",")})`]);
  const bar = { ...corners, mode: "markers", hoverinfo: "skip", marker: { size: 0.01, color: [low, high], colorscale: scale, cmin: low, cmax: high, showscale: true, colorbar: { thickness: 12 } } };
  const more = { xaxis: { range: corners.x, showgrid: false, zeroline: false, ...ticks(axes[state.x]) }, yaxis: { range: corners.y, showgrid: false, zeroline: false, ...(state.y === null ? { visible: false } : ticks(axes[state.y])) } };
  const image = { source: url, xref: "x", yref: "y", x: Math.min(...corners.x), y: Math.max(...corners.y), sizex: Math.abs(ex[ex.length - 1] - ex[0]), sizey: Math.abs(ey[ey.length - 1] - ey[0]), sizing: "stretch", layer: "below" };
  const base = layout(q.words, axes[state.x].words, state.y === null ? "" : axes[state.y].words, more);
  return react("curve", [bar], { ...base, clickanywhere: true, images: [image], shapes: ring() });
}

function drawLine(id, i) {
  const q = data.quantities[state.quantity];
  if (i === null) return react(id, [], nothing(""));
  const y = axes[i].values.map((_, k) => values()[at({ [i]: k })]), x = axes[i].numbers ? axes[i].values : axes[i].values.map((_, k) => k);
  const mark = { type: "line", x0: coordinate(i), x1: coordinate(i), yref: "paper", y0: 0, y1: 1, line: { color: COLOURS[1], width: 1.5 } };
  const base = layout(`along ${axes[i].words}`, axes[i].words, named(q.name), { xaxis: ticks(axes[i]) });
  return react(id, [{ x, y, mode: "lines+markers", line: { color: COLOURS[0] } }], { ...base, shapes: [mark] });
}

function drawValues() {
  const here = place(state.cell), where = axes.map((a, i) => `${a.name} = ${a.values[state.cell[i]]}`).join(", ");
  const known = data.quantities.map((q) => `${named(q.name)} = ${q.values[here] ?? "none"}`).join(", ");
  const reason = data.reasons[here] ? ` (${data.reasons[here]})` : "";
  element("values").textContent = `${where}: ${data.states[data.status[here]]}${reason}; ${known}`;
}

let pending = false;
function select(cell) {
  state.cell = cell.map((k, i) => Math.max(0, Math.min(k, sizes[i] - 1)));
  drawValues();
  if (!pending) requestAnimationFrame(() => { Plotly.relayout("curve", { shapes: ring() }); drawLine("along", state.x); drawLine("across", state.y); pending = false; });
  pending = true;
}

function draw() { return Promise.all([drawPlane(), drawLine("along", state.x), drawLine("across", state.y)]).then(drawValues); }

function move(i, by) { select(state.cell.map((k, j) => (j === i ? k + by : k))); }

function step(key) {
  if (key === "ArrowRight") move(state.x, 1);
  else if (key === "ArrowLeft") move(state.x, -1);
  else if (key === "ArrowUp" && state.y !== null) move(state.y, 1);
  else if (key === "ArrowDown" && state.y !== null) move(state.y, -1);
  else if (key === "Home") move(state.x, -sizes[state.x]);
  else if (key === "End") move(state.x, sizes[state.x]);
  else if (key === "q") { state.quantity = (state.quantity + 1) % data.quantities.length; element("quantity").selectedIndex = state.quantity; draw(); }
  else return false;
  return true;
}

// Values of the axes that are not drawn are chosen from lists.
function choose() {
  fill(element("quantity"), data.quantities.map((q) => q.name), data.quantities[state.quantity].name, named);
  fill(element("x"), plain.map((i) => axes[i].name), axes[state.x].name, named);
  fill(element("y"), plain.map((i) => axes[i].name), state.y === null ? "" : axes[state.y].name, named);
  element("others").replaceChildren(...plain.filter((i) => i !== state.x && i !== state.y).map((i) => {
    const label = document.createElement("label"), list = document.createElement("select");
    fill(list, axes[i].values, axes[i].values[state.cell[i]]);
    list.addEventListener("change", () => { state.cell[i] = list.selectedIndex; draw(); });
    label.append(`${named(axes[i].name)} `, list);
    return label;
  }));
}

function turned(name, other) {
  return (event) => {
    const before = state[name];
    state[name] = plain[event.target.selectedIndex];
    if (state[other] === state[name]) state[other] = before;
    choose();
    draw();
  };
}
element("quantity").addEventListener("change", (event) => { state.quantity = event.target.selectedIndex; draw(); });
element("x").addEventListener("change", turned("x", "y"));
element("y").addEventListener("change", turned("y", "x"));

prepare(draw, step);
choose();
draw().then(() => {
  element("curve").on("plotly_click", (event) => {
    const kx = nearest(axes[state.x], event.xvals ? event.xvals[0] : event.points[0].x);
    const ky = state.y === null ? null : nearest(axes[state.y], event.yvals ? event.yvals[0] : event.points[0].y);
    if (kx !== null && (state.y === null || ky !== null)) select(state.cell.map((k, i) => (i === state.x ? kx : i === state.y ? ky : k)));
  });
  ready(["curve", "along", "across"]);
});
