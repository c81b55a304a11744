// What is seen, as a scenario, as a link and as a picture.
"use strict";

// Why no file reproduces what is seen; empty where one does.
function notCopied() {
  const own = initial(), same = (name) => JSON.stringify(state[name]) === JSON.stringify(own[name]);
  return data.fixed && !(same("start") && same("truth")) ? data.fixed : "";
}

// The scenario that reproduces what is seen: its tables with these numbers and one start.
function asScenario() {
  const tables = structuredClone(data.tables), into = (key, value) => {
    const names = key.split("."), last = names.pop();
    names.reduce((table, name) => (table[name] ??= {}), tables)[last] = value;
  };
  if (variant().label && state.variant > 0) for (const name of [...data.filters, "kernels"]) delete tables[name];
  const own = allValues();
  for (const { name, key, of } of knobs()) {
    if (of === "both" && state.values[name] !== own[name]) into(key, state.values[name]);
    if (of === "plant" && name in state.truth) into(key, state.truth[name]);
  }
  if (!data.fixed) {
    tables.starts = { states: [Object.fromEntries(data.states.map((q, i) => [q.name, state.start[i]]))], start_outside: true };
    if (tables.figures) delete tables.figures.history;  // there is one run
  }
  if (data.given.some((_, k) => state.disturbance[k] !== data.disturbance[k])) {
    data.given.forEach((name, k) => into(`disturbance.${name}`, state.disturbance[k]));
  }
  const names = Object.keys(data.draws);
  if (names.length) {
    tables.varied.draws = Object.fromEntries(names.map((name) => {
      const value = state.values[name];
      return [name, data.units[name] ? { range: [value, value], unit: data.units[name] } : [value, value]];
    }));
    delete tables.varied.vertices;
  }
  if (!data.settings.continuous) {
    if (state.delay) into("run.delay", state.delay); else delete tables.run.delay;
    for (const kind of ["uniform", "normal"]) {
      const entries = data.states.map((q, i) => [q.name, state[kind][i]]).filter(([, v]) => v > 0);
      if (entries.length) { tables.noise ??= {}; tables.noise[kind] = Object.fromEntries(entries); }
      else if (tables.noise) delete tables.noise[kind];
    }
  }
  into("run.seed", BigInt(state.seed));
  return toml(tables);
}

async function copied(text, what) {
  try { await navigator.clipboard.writeText(text); notice(`${what} is on the clipboard.`); }
  catch { const area = byId("copy"); area.hidden = false; area.value = text; area.select(); notice(`${what}: press Ctrl+C.`); }
}

// The plane without handles, on the colour of the page.
function picture() {
  const found = document.createElement("canvas"), scale = 2, context = found.getContext("2d");
  [found.width, found.height] = [scale * plane.view.width, scale * plane.view.height];
  context.scale(scale, scale);
  context.fillStyle = page.colours().page;
  context.fillRect(0, 0, plane.view.width, plane.view.height);
  plane.draw(context);
  return found;
}

function saved(url, name) {
  const link = document.createElement("a");
  link.href = url; link.download = name;
  link.click();
}

// What is seen as the end of the page's address: what differs from the beginning.
function asLink() {
  const own = initial(), changes = {};
  for (const [name, value] of Object.entries(state)) {
    if (name === "values") {
      const other = Object.entries(value).filter(([key, v]) => v !== own.values[key]);
      if (other.length) changes.values = Object.fromEntries(other);
    } else if (JSON.stringify(value) !== JSON.stringify(own[name])) changes[name] = value;
  }
  return `#${encodeURIComponent(JSON.stringify(changes))}`;
}

function fromLink(text) {
  if (text.length < 2) return;
  const number = (v) => typeof v === "number" && Number.isFinite(v);
  const like = (value, own) => (Array.isArray(own) ? Array.isArray(value) && value.length === own.length && value.every(number)
    : number(own) ? number(value) : typeof own === "string" ? /^[0-9]{1,20}$/.test(value) : typeof value === "object" && value !== null && Object.values(value).every(number));
  try {
    for (const [name, value] of Object.entries(JSON.parse(decodeURIComponent(text.slice(1))))) {
      if (!(name in state) || !like(value, state[name])) throw new Error(name);
      if (name === "variant" && !(value in data.variants)) throw new Error(name);
      if (name === "axes" && (value[0] === value[1] || !value.every((k) => k in data.states))) throw new Error(name);
      state[name] = name === "values" ? { ...state.values, ...value } : value;
    }
  } catch (error) { notice(`The end of this page's address is not understood: ${error.message}`); }
}
