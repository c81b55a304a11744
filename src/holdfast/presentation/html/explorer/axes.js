// Which two states the plane shows, and of a set without a law what stands in the place of a run.
"use strict";

function atHome() { return planeX === home[0] && planeY === home[1]; }

// What the start is dragged by: the vehicles, or the two states of other axes.
function poses() {
  const found = atHome() ? data.poses : [{ place: [planeX, planeY], heading: null, label: "start" }];
  return still ? found.map((p) => ({ ...p, label: "state" })) : found;
}

// The two states of the plane are those that are chosen; the scene is drawn in the scenario's own.
function applyAxes() {
  [planeX, planeY] = data.plane = state.axes;
  const [a, b] = [planeX, planeY].map((k) => data.states[k].unit);
  metric = atHome() && a === "m" && b === "m";
  page.equal = a === b;
  page.sceneNow = null;
  page.fan = []; // its paths are over other states
  moved = 0;
  [byId("axisX").value, byId("axisY").value] = state.axes;
  levels.list(page.colours());
}

// The least and the largest value of a state on the grid of the set; null where it is not an axis.
function boxOf(k) {
  const grid = data.slices ?? variant().grid;
  const axis = grid ? (grid.states ?? data.states.map((_, i) => i)).indexOf(k) : -1;
  if (axis < 0) return null;
  const i = axis + (grid.states ? grid.shape.length - grid.states.length : 0);
  return [grid.low[i], grid.low[i] + grid.steps[i] * (grid.shape[i] - (grid.periodic[i] ? 0 : 1))];
}

// Which two states the plane shows; the same for both exchanges them.
function addAxes() {
  for (const [k, id] of ["axisX", "axisY"].entries()) {
    const choice = byId(id);
    choice.parentElement.hidden = n < 3;
    data.states.forEach((q, i) => choice.add(new Option(q.name, i)));
    choice.addEventListener("change", () => {
      const former = state.axes[k];
      state.axes[k] = Number(choice.value);
      if (state.axes[1 - k] === state.axes[k]) state.axes[1 - k] = former;
      applyAxes();
      changed();
      framed();
    });
  }
}

// The view is that of all paths, where they come soon.
async function framed() {
  clearTimeout(changed.timer);
  const pause = (time) => new Promise((done) => setTimeout(done, time));
  const followed = async () => { while (running || stale) await pause(5); };
  await Promise.race([Promise.all([fan(), followed()]), pause(500)]);
  lookAround();
  fit();
}

// What stands in the plane beside the paths, with the numbers of now.
function lookAround() {
  const loop = mainLoops[state.variant];
  loop.setParameters(() => given(), given());
  loop.prepare();
  page.sceneNow = atHome() ? loop.scene(page.stateAt(page.time), page.time) : null;
}

// All starts, paths and targets in view; walls where there is no target.
function fit() {
  const v = page.sceneNow, corners = [boxOf(planeX), boxOf(planeY)], ends = ({ at, kind }) => (kind === "Segment"
    ? [[v[at], v[at + 1]], [v[at + 2], v[at + 3]]] : [[v[at] - v[at + 2], v[at + 1] - v[at + 2]], [v[at] + v[at + 2], v[at + 1] + v[at + 2]]]);
  const fixed = (v ? data.scene : []).filter((s) => s.kind === "Segment" || s.kind === "Circle"), targets = fixed.filter((s) => !data.look.walls.includes(s.role));
  const points = [...data.starts.flatMap((s) => poses().map(({ place: [i, j] }) => [s[i], s[j]])), ...(targets.length ? targets : fixed).flatMap(ends)];
  if (corners[0] && corners[1]) for (const k of [0, 1]) points.push([corners[0][k], corners[1][k]]);
  for (const { xy } of [...page.fan, ...(page.run ? [pathOf(page.run)] : [])]) {
    for (let k = 0; k + 1 < xy.length; k += 2) points.push([xy[k], xy[k + 1]]);
  }
  plane.fit(points.map(([x, y]) => [x + page.offset[0], y + page.offset[1]]));
  page.drawn = false;
}

// Of a set without a law: no run, its own times, and the largest of them first.
function withoutRuns() {
  const { times } = data.slices;
  document.body.classList.add(times.length > 1 ? "still" : "fixed");
  Object.assign(byId("time"), { min: times[0] ?? 0, step: "any" });
  page.time = data.settings.horizon;
  byId("time").value = page.time;
}

// Whether the state is in the set.
function tellSet() {
  const { times } = data.slices;
  const value = page.slice.at(state.start[planeX], state.start[planeY]);
  const place = Math.abs(value) <= 1 ? "at the boundary of the set, as far as this page knows it" : `${value > 0 ? "in" : "outside"} the set`;
  const text = `The state is ${Number.isNaN(value) ? "outside the grid" : place}.`;
  if (text !== page.told) say(page.told = text);
  byId("now").textContent = times.length ? `${short(times[storedTime(times, page.time)])} s` : "";
}
