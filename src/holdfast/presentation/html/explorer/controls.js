// The controls beside the plane: a slider and a field for every number that can be changed.
"use strict";

const GROUPS = {
  start: "Start", disturbance: "Current and other disturbances", draws: "Drawn numbers of the scenario",
  law: "Law", tracking: "Tracking", system: "Vehicle and its limits", region: "Constraints", goal: "Goal",
  observer: "Observer", field: "Field", followers: "Followers", leader: "Leader", camera: "Camera", sensing: "Measurements", plant: "The true vehicle, which the law does not know",
};
const OPEN = ["start", "disturbance", "sensing"];

class Controls {
  constructor(place) {
    this.place = place;
    this.groups = {};
    this.entries = [];
  }

  // knob: { group, name, unit, says, low, high, get, set; above, least, most: limits of the number }.
  add(knob) {
    const scale = knob.unit === "rad" ? 180 / Math.PI : 1, unit = knob.unit === "rad" ? "deg" : knob.unit;
    const row = document.createElement("div");
    row.className = "knob";
    const truth = knob.group === "plant" ? " in truth" : "";
    const label = document.createElement("label"), id = `knob${this.entries.length}`;
    label.htmlFor = id;
    label.textContent = `${knob.name}${truth}` + (unit === "1" ? "" : ` [${unit}]`);
    if (knob.says) label.title = knob.says;
    const slider = document.createElement("input"), field = document.createElement("input");
    Object.assign(slider, { type: "range", id, min: knob.low * scale, max: knob.high * scale, step: "any" });
    Object.assign(field, { type: "number", step: "any" });
    field.setAttribute("aria-label", `${label.textContent}, number`);
    const entry = { knob, show: () => {
      const value = knob.get() * scale;
      slider.value = value;
      entry.text = `${short(value)}${unit === "1" ? "" : ` ${unit}`}`;
      slider.setAttribute("aria-valuetext", entry.text);
      if (document.activeElement !== field) field.value = Number(value.toPrecision(6));
    } };
    slider.addEventListener("input", () => { knob.set(Number(slider.value) / scale); });
    field.addEventListener("change", () => {
      const value = Number(field.value) / scale;
      const limits = [["above", (v) => value > v], ["least", (v) => value >= v], ["most", (v) => value <= v]];
      const broken = limits.filter(([name, fits]) => knob[name] !== null && knob[name] !== undefined && !fits(knob[name]));
      const fits = field.value !== "" && Number.isFinite(value) && !broken.length;
      const says = { above: "above", least: "at least", most: "at most" };
      field.setCustomValidity(fits ? "" : ["a number", ...broken.map(([name]) => `${says[name]} ${short(knob[name] * scale)}`)].join(" "));
      if (fits) knob.set(value); else field.reportValidity();
    });
    row.append(label, slider, field);
    this.group(knob.group).append(row);
    this.entries.push(entry);
    entry.show();
  }

  group(name) {
    if (!this.groups[name]) {
      const details = document.createElement("details"), summary = document.createElement("summary");
      summary.textContent = still && name === "start" ? "State" : GROUPS[name] || name;
      details.open = OPEN.includes(name);
      details.setAttribute("aria-label", summary.textContent);
      details.append(summary);
      this.place.append(details);
      this.groups[name] = details;
    }
    return this.groups[name];
  }

  show() {
    for (const entry of this.entries) entry.show();
    byId("numbers").textContent = `${this.entries.filter(({ knob }) => knob.group !== "plant" || knob.name in state.truth).map(({ knob, text }) => `${knob.group === "plant" ? "true " : ""}${knob.name} = ${text}`).join("; ")}.`;
  }
}

// A table of a scenario as TOML.
function toml(tables) {
  const key = (k) => (/^[A-Za-z0-9_-]+$/.test(k) ? k : JSON.stringify(k));
  const value = (v) => {
    if (Array.isArray(v)) return `[${v.map(value).join(", ")}]`;
    if (v !== null && typeof v === "object")
      return `{ ${Object.entries(v).map(([k, x]) => `${key(k)} = ${value(x)}`).join(", ")} }`;
    if (typeof v === "string") return JSON.stringify(v);
    return String(v);
  };
  return Object.entries(tables).map(([name, table]) => `[${key(name)}]\n`
    + Object.entries(table).map(([k, v]) => `${key(k)} = ${value(v)}`).join("\n")).join("\n\n") + "\n";
}
