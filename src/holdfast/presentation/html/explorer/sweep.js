// The table of a sweep: a map whose cell under the pointer is what runs.
"use strict";

// viridis, in nine places
const COLOURS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
const OWN = -1; // no cell: the scenario's own numbers

function colourAt(share) {
  const at = Math.min(Math.max(share, 0), 1) * (COLOURS.length - 1), k = Math.min(Math.floor(at), COLOURS.length - 2);
  const part = (i) => [COLOURS[k], COLOURS[k + 1]].map((c) => parseInt(c.slice(1 + 2 * i, 3 + 2 * i), 16));
  return `rgb(${[0, 1, 2].map((i) => { const [a, b] = part(i); return Math.round(a + (at - k) * (b - a)); }).join(" ")})`;
}

class Sweep {
  static async of(packed) { return new Sweep(JSON.parse(new TextDecoder().decode(await unpacked(packed)))); }

  constructor(table) {
    Object.assign(this, table);
    this.canvas = byId("map");
    this.context = this.canvas.getContext("2d");
    this.ownStarts = data.starts;
    this.variable = Object.fromEntries(this.variables.map((v) => [v.name, v]));
    this.count = this.settings.length;
    this.cell = OWN; // what runs; state.cell is what stays when the pointer leaves the map
    this.across = 0;
    this.up = this.axes.length > 1 ? 1 : null;
    this.at = this.axes.map((axis) => Math.floor(axis.values.length / 2)); // of names that sliders hold
    this.choices();
    this.listen();
  }

  // -- what is chosen: the variable, two names, the values of the others ------------------------

  choices() {
    const shown = byId("shown"), axes = [["across", byId("across")], ["up", byId("up")]];
    for (const v of this.variables) shown.add(new Option(v.label, v.name, false, v.name === this.shown));
    shown.addEventListener("change", () => { this.shown = shown.value; this.tell(); });
    const [, up] = axes[1];
    for (const [which, choice] of axes) {
      choice.parentElement.hidden = this.axes.length < (which === "up" ? 2 : 3);
      this.axes.forEach((axis, k) => choice.add(new Option(axis.label, k, false, k === this[which])));
      choice.addEventListener("change", () => {
        const other = which === "up" ? "across" : "up", former = this[which];
        this[which] = Number(choice.value);
        if (this[other] === this[which]) { this[other] = former; byId(other).value = former; }
        this.held();
        this.tell();
      });
    }
    up.parentElement.hidden = this.axes.length < 3;
    byId("own").addEventListener("click", () => this.choose(OWN));
    this.held();
  }

  // A slider for every name of a grid that is not an axis of the map.
  held() {
    const place = byId("others");
    place.replaceChildren();
    if (!this.grid) return;
    this.axes.forEach((axis, k) => {
      if (k === this.across || k === this.up) return;
      const label = document.createElement("label"), slider = document.createElement("input");
      Object.assign(slider, { type: "range", min: 0, max: axis.values.length - 1, step: 1, value: this.at[k] });
      const text = document.createElement("span");
      const say = () => { text.textContent = this.valueText(axis, this.at[k]); slider.setAttribute("aria-valuetext", text.textContent); };
      slider.setAttribute("aria-label", axis.label);
      slider.addEventListener("input", () => {
        this.at[k] = Number(slider.value);
        say();
        if (state.cell !== OWN) { const of = this.placesOf(state.cell); of[k] = this.at[k]; this.choose(this.cellOf(of)); }
        this.draw();
      });
      say();
      label.append(slider, text);
      place.append(label);
    });
  }

  valueText(axis, k) {
    const [unit, scale] = shownUnit(axis.unit);
    return `${axis.label} = ${short(axis.values[k] * scale)}${unit === "1" ? "" : ` ${unit}`}`;
  }
  axisText(axis) {
    const [unit] = shownUnit(axis.unit);
    return axis.label + (unit === "1" ? "" : ` [${unit}]`);
  }

  // -- cells: of a grid their place on every axis, the last fastest; of a sample their number -----

  placesOf(cell) {
    const found = [];
    for (let k = this.axes.length - 1; k >= 0; k--) { const size = this.axes[k].values.length; found[k] = cell % size; cell = Math.floor(cell / size); }
    return found;
  }
  cellOf(places) { return places.reduce((cell, place, k) => cell * this.axes[k].values.length + place, 0); }
  refused(cell) { return this.variable.refused.values[cell] === 1; }

  // The names that a cell gives one value, so that they are not drawn.
  fixed() { return this.runs() ? this.entries.filter((e) => e.group === "draws").map((e) => e.name) : []; }
  runs() { return this.cell !== OWN && !this.refused(this.cell); }

  // The numbers of a cell in a state of the page; those of the scenario for no cell or a refused one.
  into(found, cell) {
    const own = initial();
    for (const { group, name, values } of this.entries) {
      const value = cell === OWN || this.refused(cell) ? null : values[cell];
      if (group === "values" || group === "draws") found.values[name] = value ?? own.values[name];
      else if (group === "truth" && (value ?? own.truth[name]) === undefined) delete found.truth[name];
      else if (group === "truth") found.truth[name] = value ?? own.truth[name];
      else if (group === "delay") found.delay = value ?? own.delay;
      else {
        const k = group === "disturbance" ? data.given.indexOf(name) : data.states.findIndex((q) => q.name === name);
        found[group][k] = value ?? own[group][k];
      }
    }
    return found;
  }

  // What runs: a cell, or the scenario's own numbers.
  show(cell) {
    if (cell === this.cell) return;
    this.cell = cell;
    const before = data.starts;
    data.starts = this.runs() && this.starts_of ? this.starts[this.starts_of[cell]] : this.ownStarts;
    if (JSON.stringify(state.start) === JSON.stringify(before[0])) state.start = [...data.starts[0]];
    this.into(state, cell);
    changed();
  }
  choose(cell) {
    state.cell = cell;
    if (cell !== OWN && this.grid) this.at = this.placesOf(cell);
    if (cell === this.cell) this.draw();
    this.show(cell);
  }
  // After a state was set as a whole, from a link or by a reset.
  taken() {
    if (!(state.cell >= OWN && state.cell < this.count)) state.cell = OWN;
    if (state.cell !== OWN && this.grid) this.at = this.placesOf(state.cell);
    this.cell = state.cell;
    const before = data.starts;
    data.starts = this.runs() && this.starts_of ? this.starts[this.starts_of[this.cell]] : this.ownStarts;
    if (JSON.stringify(state.start) === JSON.stringify(before[0])) state.start = [...data.starts[0]];
    this.held();
  }

  // Whether the page runs with the numbers of the cell; the place of the one start does not count.
  unchanged() {
    const own = this.into(initial(), this.cell), free = drawnNames().filter((name) => !this.fixed().includes(name));
    const numbers = ({ variant, values, truth, disturbance, uniform, normal, delay, seed }) => JSON.stringify(
      [variant, Object.entries(values).filter(([name]) => !free.includes(name)).sort(), Object.entries(truth).sort(), disturbance, uniform, normal, delay, seed]);
    return numbers(own) === numbers(state);
  }

  // -- in words ------------------------------------------------------------------------------------

  tell() { byId("cell").textContent = this.words().join(" "); this.draw(); }

  words() {
    const { cell } = this;
    if (cell === OWN) return ["The scenario's own numbers. Point at the map, and the cell runs; a click or a tap keeps it."];
    const place = this.grid ? this.placesOf(cell) : this.axes.map(() => cell);
    const name = this.axes.map((axis, k) => this.valueText(axis, place[k])).join(", ");
    if (this.refused(cell)) return [`${name}: refused: ${this.notes[cell]}.`, "The scenario's own numbers run."];
    const said = [`${name}: ${this.numberText(cell)}.`, `${this.countText(cell)}.`];
    if (this.notes[cell]) said.push(`${this.notes[cell]}.`);
    if (!this.unchanged()) said.push("Other numbers are changed: what runs is not this cell.");
    else if (page.fanIsNow) said.push(this.agreement(cell));
    return said;
  }

  numberText(cell) {
    const v = this.variable[this.shown], value = v.values[cell];
    if (value === null) return `${v.label}: none`;
    if (!v.share) { const [unit, scale] = shownUnit(v.unit); return `${v.label} ${short(value * scale)}${unit === "1" ? "" : ` ${unit}`}`; }
    const percent = (x) => (100 * x).toFixed(1), of = (end) => this.variable[`${v.name}_${end}`].values[cell];
    return `${v.label} ${percent(value)} % (95 %: ${percent(of("low"))} to ${percent(of("high"))} %)`;
  }

  // The outcomes of the table by label.
  counts(cell) {
    const found = Object.keys(data.look.outcomes).map((label) => [label, this.variable[label.replaceAll(" ", "_")]?.values[cell] ?? 0]);
    return Object.fromEntries(found.filter(([, count]) => count > 0));
  }
  countText(cell) {
    const total = this.variable.runs.values[cell];
    const said = Object.entries(this.counts(cell)).map(([label, count]) => `${label} ${count}`);
    return `Of ${total} runs: ${said.join(", ")}`;
  }
  agreement(cell) {
    const total = this.variable.runs.values[cell];
    if (total > data.starts.length) return `The page runs the first ${data.starts.length}.`;
    const labels = Object.keys(data.look.outcomes), found = {};
    for (const { outcome } of page.fan) found[labels[outcome]] = (found[labels[outcome]] || 0) + 1;
    const wanted = this.counts(cell), names = new Set([...Object.keys(found), ...Object.keys(wanted)]);
    return [...names].every((name) => found[name] === wanted[name]) ? "All of them end here as in the table."
      : "The runs of this page do not end as in the table.";
  }

  // -- the map -----------------------------------------------------------------------------------

  arrange() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.area = { left: 54, right: width - 66, top: 10, bottom: height - 38, width, height };
  }

  // The lowest and the highest value of the variable; of a share 0 and 1.
  range(v) {
    if (v.share) return [0, 1];
    const known = v.values.filter((x) => x !== null), low = Math.min(...known), high = Math.max(...known);
    return high > low ? [low, high] : [low - 0.5, low + 0.5];
  }

  // Shares from 0 to 1 along an axis: of a grid the middles of equally wide cells, of a sample values.
  placed(k) {
    const { values, log } = this.axes[k];
    if (this.grid) return values.map((_, i) => (i + 0.5) / values.length);
    const of = log ? values.map(Math.log) : values, low = Math.min(...of), high = Math.max(...of);
    return of.map((v) => (high > low ? 0.03 + 0.94 * (v - low) / (high - low) : 0.5));
  }

  draw() {
    this.arrange();
    const { context: c, area: a } = this, look = page.colours(), v = this.variable[this.shown];
    c.clearRect(0, 0, a.width, a.height);
    c.font = "12px system-ui, sans-serif";
    this.spots = this.up === null ? this.curveSpots(v) : this.grid ? this.gridSpots() : this.sampleSpots();
    if (this.up === null) this.curve(v, look); else this.cells(v, look);
    this.marked(look);
    c.strokeStyle = look.line; c.lineWidth = 1;
    c.strokeRect(a.left, a.top, a.right - a.left, a.bottom - a.top);
    this.scales(v, look);
  }

  // Where cells are on the canvas: { cell, x, y, w, h } of its rectangle, or of its dot.
  gridSpots() {
    const { area: a } = this, nx = this.axes[this.across].values.length, ny = this.axes[this.up].values.length;
    const w = (a.right - a.left) / nx, h = (a.bottom - a.top) / ny, found = [];
    for (let i = 0; i < nx; i++) for (let j = 0; j < ny; j++) {
      const places = [...this.at];
      places[this.across] = i; places[this.up] = j;
      found.push({ cell: this.cellOf(places), i, j, x: a.left + i * w, y: a.bottom - (j + 1) * h, w, h });
    }
    return found;
  }
  sampleSpots() {
    const xs = this.placed(this.across), ys = this.placed(this.up);
    return xs.map((x, cell) => this.dot(cell, x, ys[cell]));
  }
  curveSpots(v) {
    const [low, high] = this.range(v);
    return this.placed(0).map((x, cell) => this.dot(cell, x, v.values[cell] === null ? 0 : 0.03 + 0.94 * (v.values[cell] - low) / (high - low)));
  }
  dot(cell, x, y) {
    const { area: a } = this, size = 9;
    return { cell, x: a.left + x * (a.right - a.left) - size / 2, y: a.bottom - y * (a.bottom - a.top) - size / 2, w: size, h: size };
  }

  cells(v, look) {
    const { context: c } = this, [low, high] = this.range(v);
    for (const { cell, x, y, w, h } of this.spots) {
      const value = v.values[cell];
      if (value === null || (this.refused(cell) && v.name !== "refused")) { this.hatched(x, y, w, h, look); continue; }
      c.fillStyle = colourAt((value - low) / (high - low));
      c.fillRect(x, y, w + 0.5, h + 0.5);
    }
  }
  hatched(x, y, w, h, look) {
    const { context: c } = this;
    c.strokeStyle = look.soft; c.lineWidth = 1;
    c.beginPath(); c.moveTo(x, y + h); c.lineTo(x + w, y); c.moveTo(x, y); c.lineTo(x + w, y + h); c.stroke();
  }

  curve(v, look) {
    const { context: c, area: a } = this, [low, high] = this.range(v), order = [...this.spots].sort((p, q) => p.x - q.x);
    const middle = (s) => [s.x + s.w / 2, s.y + s.h / 2], py = (x) => a.bottom - (0.03 + 0.94 * (x - low) / (high - low)) * (a.bottom - a.top);
    const known = order.filter((s) => v.values[s.cell] !== null);
    c.strokeStyle = look.current; c.fillStyle = look.current; c.lineWidth = 1.5;
    if (v.share) for (const s of known) {
      const [x] = middle(s);
      c.beginPath(); c.moveTo(x, py(this.variable[`${v.name}_low`].values[s.cell])); c.lineTo(x, py(this.variable[`${v.name}_high`].values[s.cell])); c.stroke();
    }
    if (this.grid) { c.beginPath(); known.forEach((s, k) => (k ? c.lineTo(...middle(s)) : c.moveTo(...middle(s)))); c.stroke(); }
    for (const s of order) {
      if (v.values[s.cell] === null) { this.hatched(s.x, a.bottom - s.h, s.w, s.h, look); continue; }
      c.beginPath(); c.arc(...middle(s), 3.5, 0, 2 * Math.PI); c.fill();
    }
  }

  // The cell that runs, and the one that stays.
  marked(look) {
    const { context: c } = this;
    for (const [cell, colour, wide] of [[state.cell, look.goals, 3], [this.cell, look.text, 1.5]]) {
      const spot = this.spots.find((s) => s.cell === cell);
      if (!spot) continue;
      c.lineWidth = wide + 2; c.strokeStyle = look.page; c.strokeRect(spot.x, spot.y, spot.w, spot.h);
      c.lineWidth = wide; c.strokeStyle = colour; c.strokeRect(spot.x, spot.y, spot.w, spot.h);
    }
  }

  scales(v, look) {
    const { context: c, area: a } = this, [low, high] = this.range(v), [unit, scale] = shownUnit(v.unit);
    const said = (x) => (v.share ? `${short(100 * x)} %` : short(x * scale));
    c.fillStyle = look.soft;
    c.textAlign = "center"; c.textBaseline = "top";
    this.ticks(this.across, (a.right - a.left) / 46).forEach(([at, text]) => c.fillText(text, a.left + at * (a.right - a.left), a.bottom + 4));
    c.fillStyle = look.text; c.textBaseline = "bottom";
    c.fillText(this.axisText(this.axes[this.across]), (a.left + a.right) / 2, a.height - 2);
    c.textAlign = "right"; c.textBaseline = "middle"; c.fillStyle = look.soft;
    if (this.up === null) for (const share of [0, 0.5, 1]) c.fillText(said(low + share * (high - low)), a.left - 5, a.bottom - (0.03 + 0.94 * share) * (a.bottom - a.top));
    else this.ticks(this.up, (a.bottom - a.top) / 22).forEach(([at, text]) => c.fillText(text, a.left - 5, a.bottom - at * (a.bottom - a.top)));
    c.fillStyle = look.text; c.textAlign = "center";
    c.save(); c.translate(9, (a.top + a.bottom) / 2); c.rotate(-Math.PI / 2);
    c.fillText(this.up === null ? (v.share || unit === "1" ? v.name.replaceAll("_", " ") : `${v.name.replaceAll("_", " ")} [${unit}]`) : this.axisText(this.axes[this.up]), 0, 0);
    c.restore();
    if (this.up !== null) this.bar(low, high, said, unit, look);
  }

  // [share along the axis, text], at most `most` of them.
  ticks(k, most) {
    const axis = this.axes[k], [, scale] = shownUnit(axis.unit), places = this.placed(k);
    const order = axis.values.map((value, i) => [places[i], short(value * scale)]).sort((p, q) => p[0] - q[0]);
    if (this.grid) { const every = Math.ceil(order.length / Math.max(Math.floor(most), 1)); return order.filter((_, i) => i % every === 0); }
    return [order[0], order.at(-1)];
  }

  bar(low, high, said, unit, look) {
    const { context: c, area: a } = this, x = a.right + 10, high_px = a.bottom - a.top;
    for (let k = 0; k < 64; k++) { c.fillStyle = colourAt((k + 0.5) / 64); c.fillRect(x, a.bottom - ((k + 1) / 64) * high_px, 10, high_px / 64 + 0.5); }
    c.fillStyle = look.soft; c.textAlign = "left"; c.textBaseline = "middle";
    for (const share of [0, 0.5, 1]) c.fillText(said(low + share * (high - low)), x + 13, Math.min(Math.max(a.bottom - share * high_px, a.top + 6), a.bottom - 6));
    if (unit !== "1") { c.textBaseline = "bottom"; c.fillText(unit, x, a.height - 2); }
  }

  // -- pointer and keys ----------------------------------------------------------------------------

  cellAt(px, py) {
    const { area: a } = this;
    if (!a || px < a.left - 6 || px > a.right + 6 || py < a.top - 6 || py > a.bottom + 6) return null;
    const far = (s) => {
      const dx = Math.max(s.x - px, 0, px - s.x - s.w), dy = this.up === null ? 0 : Math.max(s.y - py, 0, py - s.y - s.h);
      return dx * dx + dy * dy;
    };
    let best = null;
    for (const spot of this.spots) if (!best || far(spot) < far(best)) best = spot;
    return best && best.cell;
  }

  listen() {
    const { canvas } = this, at = (event) => { const box = canvas.getBoundingClientRect(); return this.cellAt(event.clientX - box.left, event.clientY - box.top); };
    canvas.addEventListener("pointermove", (event) => {
      if (event.pointerType === "touch") return;
      this.show(at(event) ?? state.cell);
    });
    canvas.addEventListener("pointerleave", () => this.show(state.cell));
    canvas.addEventListener("click", (event) => { const cell = at(event); if (cell !== null) this.choose(cell); });
    canvas.addEventListener("keydown", (event) => {
      const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (event.key === "Escape") this.choose(OWN);
      else if (moves[event.key]) this.step(...moves[event.key]);
      else return;
      event.preventDefault();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // The next cell of a grid in a direction; of a sample the nearest one there.
  step(dx, dy) {
    const now = this.spots.find((s) => s.cell === state.cell);
    if (!now) { this.choose(this.spots[0].cell); return; }
    const along = (s) => dx * (s.x - now.x) - dy * (s.y - now.y), across = (s) => Math.abs(dx) * Math.abs(s.y - now.y) + Math.abs(dy) * Math.abs(s.x - now.x);
    if (this.up === null && dy) return;
    const weigh = (s) => along(s) + (this.up === null ? 0 : (this.grid ? 1e6 : 2) * across(s));
    const there = this.spots.filter((s) => along(s) > 0.5).sort((p, q) => weigh(p) - weigh(q));
    if (there.length) this.choose(there[0].cell);
  }
}
