// The page: what is drawn of the runs, and what is dragged.
"use strict";

// -- the page ------------------------------------------------------------------------------------

const HEADING = data.poses[0].heading;
let metric; // whether the plane is that of the vehicle's positions
const page = {
  data, run: null, fan: [], slice: null, sceneNow: null, time: 0, playing: false, drawn: false,
  equal: false, recordEvery: data.settings.record_every,
  fanSeconds: null, fanIsNow: false, printing: false,
  axisUnit(k) { return shownUnit(data.states[state.axes[k]].unit); },
  axisLabel(k) { const [unit] = page.axisUnit(k), { name } = data.states[state.axes[k]]; return unit === "1" ? name : `${name} [${unit}]`; },
  colours() {
    if (page.look) return page.look;
    const style = getComputedStyle(document.documentElement), of = (name) => style.getPropertyValue(`--${name}`).trim();
    const dark = of("dark") === "1", shown = (c) => (dark && c === "#222222" ? "#e4e8ec" : c);
    page.look = {
      page: of("page"), card: of("card"), line: of("line"), text: of("text"), soft: of("soft"), accent: of("accent"),
      wall: of("soft"), goals: "#CC79A7", constraint: of("constraint"), forbidden: of("forbidden"), goal: "#009E73", goalArea: of("goal"), view: "#E69F00", current: "#0072B2", set: of("set"), limit: "#D55E00",
      outcomes: Object.values(data.look.outcomes).map(shown), lines: data.look.lines.map(shown),
      dashes: data.look.dashes, dashesOf: (outcome, width) => dashed(data.look.outcome_dashes[outcome], width),
      modes: ["#0072B2", "#E69F00", "#CC79A7", of("text"), "#999999"], // no colour of an outcome
    };
    return page.look;
  },
  stateAt(time) {
    const run = page.run;
    if (!run || !run.count) return state.start;
    const at = Math.min(time / page.recordEvery, run.count - 1), k = Math.floor(at), part = at - k;
    return data.states.map((q, i) => {
      const a = run.state[k * n + i], b = k + 1 < run.count ? run.state[(k + 1) * n + i] : a;
      let change = b - a;
      if (q.angle) change -= 2 * Math.PI * Math.round(change / (2 * Math.PI));
      return a + part * change;
    });
  },
  posesNow() {
    const now = page.stateAt(page.time), views = data.scene.filter((s) => (s.kind === "Cone" || s.kind === "Footprint") && !isBody(s));
    if (page.sceneNow && data.scene.some(isBody)) return []; // it is drawn with its trailers
    const own = { x: now[planeX], y: now[planeY], heading: HEADING === null || !atHome() ? null : now[HEADING] };
    const others = page.sceneNow ? views.map(({ at }) => ({ x: page.sceneNow[at], y: page.sceneNow[at + 1], heading: page.sceneNow[at + 2] })) : [];
    return others.some((p) => Math.hypot(p.x - own.x, p.y - own.y) < 1e-9) ? others : [own, ...others];
  },
  startPoses() {
    return poses().map(({ place: [i, j], heading, label }) => (
      { x: state.start[i], y: state.start[j], heading: heading === null ? null : state.start[heading], label }));
  },
  get offset() { return atHome() ? state.offset : [0, 0]; },
  targetPlace() {
    const target = data.scene.find((s) => s.role === "target" && s.kind === "Segment"), v = page.sceneNow;
    return target && metric && v ? [(v[target.at] + v[target.at + 2]) / 2, (v[target.at + 1] + v[target.at + 3]) / 2] : null;
  },
  current() {
    const [a, b] = currentRows();
    if (a === undefined) return null;
    return { value: [state.disturbance[a], state.disturbance[b]], unit: "m/s",
      most: Math.max(data.most[a] ?? data.most_current, data.most[b] ?? data.most_current) };
  },
};

function currentRows() {
  const rows = data.current.map((name) => data.given.indexOf(name));
  return metric && !still && rows.every((row) => row >= 0) ? rows : [];
}

const levels = new Levels(page);
page.levelsOf = (plane) => (mainLoops.length ? levels.of(plane, mainLoops[state.variant]) : []);
const plane = new Plane(byId("plane"), page), strips = new Strips(byId("strips"), page);
const controls = new Controls(byId("controls"));
let mainLoops = [], makeSlices = [], moved = 0; // the pose that keys move

function changed() {
  stale = true;
  page.fanIsNow = false;
  byId("outcomes").classList.add("old");
  follow();
  clearTimeout(changed.timer);
  if (byId("fan").checked) changed.timer = setTimeout(fan, 120);
  controls.show();
  sweep?.tell();
}

function say(text) { byId("status").textContent = text; }
function notice(text) { byId("notice").textContent = text; }

function tell() {
  const run = page.run, labels = Object.keys(data.look.outcomes);
  const parts = [`${labels[run.outcome]}`];
  if (run.ended === "LEFT") {
    const broken = data.constraints[run.exitConstraint];
    parts[0] = `left the region at ${short(run.exitTime)} s` + (broken ? `, by ${broken[0].replaceAll("_", " ")}` : "");
  } else if (run.ended === "REACHED") parts[0] = `reached the goal at ${short(run.goalTime)} s`;
  else if (run.ended === "STAYED") parts[0] = data.constraints.length ? `stayed for ${short(data.settings.horizon)} s` : `ran for ${short(data.settings.horizon)} s`;
  else if (run.ended === "DIVERGED") parts[0] = "diverged";
  if (run.infeasible > 0) parts.push(`no admissible input at ${run.infeasible} samples`);
  if (run.overruled > 0) parts.push(`the filter changed the command at ${run.overruled} samples`);
  if (run.switches > 0) parts.push(`${run.switches} changes of mode`);
  say(parts.join("; ") + ".");
  byId("status").dataset.outcome = labels[run.outcome];
  byId("modes").replaceChildren(...(run.mode ? variant().modes : []).map((name, k) =>
    marked(page.colours().modes[k % page.colours().modes.length], name.replaceAll("_", " "), page.colours().dashes[k % page.colours().dashes.length])));
}

// An entry of a list with its line.
function marked(colour, text, pattern = []) {
  const of = (name, values) => { const e = document.createElementNS("http://www.w3.org/2000/svg", name); for (const [k, v] of Object.entries(values)) e.setAttribute(k, v); return e; };
  const item = document.createElement("li"), mark = of("svg", { class: "mark", viewBox: "0 0 30 4", "aria-hidden": "true" });
  mark.append(of("line", { x1: 0, y1: 2, x2: 30, y2: 2, stroke: colour, "stroke-width": 3, "stroke-dasharray": dashed(pattern, 2).join(" ") || "none" }));
  item.append(mark, text);
  return item;
}

function tellFan() {
  const counts = {};
  for (const path of page.fan) counts[path.outcome] = (counts[path.outcome] || 0) + 1;
  const list = byId("outcomes");
  list.replaceChildren();
  const labels = Object.keys(data.look.outcomes);
  for (const [outcome, count] of Object.entries(counts)) {
    list.append(marked(page.colours().outcomes[outcome], `${labels[outcome]}: ${count} of ${page.fan.length}`, data.look.outcome_dashes[outcome]));
  }
  list.classList.remove("old");
  list.dataset.seconds = page.fanSeconds ?? "";
  sweep?.tell();
}

function groups() {
  const run = page.run, look = page.colours(), found = [];
  const colour = (k) => look.lines[k % look.lines.length], dash = (k) => dashed(look.dashes[k % look.dashes.length], 1.6);
  const units = [...new Set(data.constraints.map((c) => c[1]))], m = data.constraints.length;
  for (const unit of units) {
    const [shown, scale] = shownUnit(unit);
    found.push({ title: `constraints${shown === "1" ? "" : ` [${shown}]`}, violated above 0:`, limit: 0, scale, lines: data.constraints
      .map(([name], j) => ({ name: name.replaceAll("_", " "), j, unit: data.constraints[j][1] }))
      .filter((line) => line.unit === unit)
      .map((line, k) => ({ name: line.name, colour: colour(k), dash: dash(k), values: (r) => run.constraint[r * m + line.j] })) });
  }
  const inputs = data.inputs.length;
  for (const unit of [...new Set(data.inputs.map((q) => q.unit))]) {
    const lines = [];
    data.inputs.forEach((q, j) => {
      if (q.unit !== unit) return;
      if (run.nominal) lines.push({ steps: !data.settings.continuous, name: `${q.name} asked for`, colour: look.soft, dash: [3, 3], values: (r) => run.nominal[r * inputs + j] });
      lines.push({ steps: !data.settings.continuous, name: q.name, colour: colour(j), dash: dash(j), values: (r) => run.input[r * inputs + j] });
    });
    found.push({ title: `inputs${unit === "1" ? "" : ` [${unit}]`}:`, lines });
  }
  return found;
}

let lastFrame = 0;
function frame(now) {
  const passed = Math.min((now - lastFrame) / 1000, 0.1);
  lastFrame = now;
  if (page.playing && (page.run || still)) {
    page.time += passed * Number(byId("speed").value);
    if (page.time >= data.settings.horizon) { page.time = data.settings.horizon; play(false); }
    byId("time").value = page.time;
    page.drawn = false;
  }
  if (!page.drawn && (page.run || still)) draw();
  requestAnimationFrame(frame);
}

function draw() {
  page.drawn = true;
  const set = makeSlices[state.variant], at = page.stateAt(page.time);
  lookAround();
  page.slice = set ? set(at, still ? page.time : data.settings.horizon - page.time, planeX, planeY) : null;
  plane.draw();
  if (still) { tellSet(); return; }
  strips.draw(groups(), data.settings.horizon, page.time);
  byId("now").textContent = `${page.time.toFixed(1)} s` + (page.run.mode ? `, ${variant().modes[modeNow()].replaceAll("_", " ")}` : "");
}

function modeNow() {
  return page.run.mode[Math.min(Math.floor(page.time / page.recordEvery), page.run.count - 1)];
}

function play(on) {
  page.playing = on;
  if (on && page.time >= data.settings.horizon) page.time = Number(byId("time").min);
  byId("play").textContent = on ? "Pause" : "Play";
}

// -- the controls --------------------------------------------------------------------------------

function spread(values, least) {
  const low = Math.min(...values), high = Math.max(...values), pad = Math.max(0.25 * (high - low), least);
  return [low - pad, high + pad];
}

// The numbers of all variants, each once.
function knobs() {
  return [...new Map(data.variants.flatMap((v) => v.knobs).map((knob) => [knob.key, knob])).values()];
}

function addControls() {
  data.states.forEach((q, i) => {
    const [low, high] = boxOf(i) ?? (q.angle ? [-Math.PI, Math.PI] : spread(data.starts.map((s) => s[i]), q.unit === "m" ? 0.5 : 0.2));
    controls.add({ ...q, group: "start", low, high, get: () => state.start[i], set: (v) => { state.start[i] = v; changed(); } });
  });
  if (still) return;
  data.given.forEach((name, k) => {
    const q = data.disturbances.find((d) => d.name === name), most = data.most[k] ?? (Math.abs(state.disturbance[k]) * 2 || data.most_current);
    controls.add({ ...q, group: "disturbance", low: -most, high: most, least: data.most[k] === null ? undefined : -most, most: data.most[k] ?? undefined, get: () => state.disturbance[k],
      set: (v) => { state.disturbance[k] = v; changed(); } });
  });
  for (const [name, [low, high]] of Object.entries(data.draws)) {
    controls.add({ name, unit: data.units[name] || "1", group: "draws", low, high, get: () => state.values[name],
      set: (v) => { state.values[name] = v; changed(); } });
  }
  for (const knob of knobs()) {
    const { name } = knob, values = allValues(), of_plant = knob.of === "plant";
    const base = of_plant ? data.plant[name] ?? values[name] : values[name];
    if (!base) continue;
    const wide = of_plant ? 0.5 : 1, ends = [base - wide * Math.abs(base), base + wide * Math.abs(base)].map(
      (v) => (knob.above !== null && v <= knob.above ? knob.above + 1e-3 * Math.abs(base) : v));
    controls.add({ ...knob, low: ends[0], high: ends[1],
      get: of_plant ? () => state.truth[name] ?? state.values[name] : () => state.values[name],
      set: (v) => { (of_plant ? state.truth : state.values)[name] = v; changed(); } });
  }
  if (!data.settings.continuous) {
    controls.add({ name: "delay", unit: "s", says: "by how long the law sees everything late", group: "sensing", low: 0,
      high: data.variants[0].loop.latest * data.settings.sample_time, least: 0, most: data.variants[0].loop.latest * data.settings.sample_time, get: () => state.delay,
      set: (v) => { state.delay = Math.round(v / data.settings.sample_time) * data.settings.sample_time; changed(); } });
    data.states.forEach((q, i) => controls.add({ ...q, name: `noise of ${q.name}`, says: "half the width of uniform noise", group: "sensing",
      low: 0, high: q.unit === "rad" ? 0.1 : 0.05, least: 0, get: () => state.uniform[i], set: (v) => { state.uniform[i] = v; changed(); } }));
  }
}

// -- the beginning ---------------------------------------------------------------------------------

function theme(next) {
  if (next) document.documentElement.dataset.theme = next;
  page.look = null;
  page.drawn = false;
  tellFan();
  levels.list(page.colours());
  if (page.run) tell();
}

async function begin() {
  const time = byId("time");
  time.max = data.settings.horizon;
  time.step = page.recordEvery / 4;
  if (data.sweep) sweep = await Sweep.of(data.sweep);
  addControls();
  const choice = byId("variant");
  choice.parentElement.hidden = data.variants.length < 2;
  data.variants.forEach(({ label }, k) => choice.add(new Option(label, k)));
  addAxes();
  fromLink(location.hash);
  applyAxes();
  if (still) withoutRuns();
  sweep?.taken();
  choice.value = state.variant;
  controls.show();
  choice.addEventListener("change", () => { state.variant = Number(choice.value); changed(); });
  byId("play").addEventListener("click", () => play(!page.playing));
  time.addEventListener("input", () => { page.time = Number(time.value); page.drawn = false; });
  byId("fan").addEventListener("change", fan);
  byId("levels").addEventListener("change", () => { levels.list(page.colours()); page.drawn = false; });
  byId("reset").addEventListener("click", () => { state = initial(); applyAxes(); sweep?.taken(); page.time = still ? data.settings.horizon : 0; time.value = page.time; choice.value = 0; changed(); framed(); });
  byId("toml").hidden = data.tables === null;
  byId("toml").addEventListener("click", () => { const said = notCopied(); if (said) notice(said); else copied(asScenario(), "The scenario"); });
  byId("link").addEventListener("click", () => copied(location.href.split("#")[0] + asLink(), "The link"));
  window.addEventListener("hashchange", () => { state = initial(); fromLink(location.hash); applyAxes(); sweep?.taken(); choice.value = state.variant; changed(); framed(); });
  byId("png").addEventListener("click", () => saved(picture().toDataURL("image/png"), `${data.name}.png`));
  byId("fit").addEventListener("click", fit);
  byId("svg").addEventListener("click", () => {
    const context = new SvgContext(plane.view.width, plane.view.height);
    plane.draw(context);
    saved(URL.createObjectURL(new Blob([context.text(page.colours().page)], { type: "image/svg+xml" })), `${data.name}.svg`);
  });
  byId("theme").addEventListener("click", () => {
    const dark = getComputedStyle(document.documentElement).getPropertyValue("--dark").trim() === "1";
    theme(dark ? "light" : "dark");
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => theme());
  new ResizeObserver(() => { page.drawn = false; }).observe(canvas);
  let own = null; // the theme before a print, which is light
  const printed = (on) => {
    const root = document.documentElement;
    if (on === page.printing) return;
    page.printing = on;
    if (on) { own = root.dataset.theme; root.dataset.theme = "light"; }
    else if (own) root.dataset.theme = own;
    else delete root.dataset.theme;
    theme(); draw(); sweep?.draw();
  };
  matchMedia("print").addEventListener("change", (event) => printed(event.matches));
  for (const kind of ["beforeprint", "afterprint"]) window.addEventListener(kind, () => printed(kind === "beforeprint"));
  mainLoops = await Promise.all(data.variants.map((v) => ClosedLoop.of(v.loop)));
  makeSlices = still ? [await ofSet(data.slices)] : mainLoops.map((loop, k) => ofLaw(loop, data.variants[k].grid));
  lookAround();
  await follow();
  await framed();
  requestAnimationFrame((now) => { lastFrame = now; frame(now); });
  document.body.dataset.ready = "1";
}

begin().catch((error) => say(`This page needs WebAssembly with SIMD: ${error.message}`));
