// What is dragged, and what keys do, in the plane and along the histories.
"use strict";

let held = null;
const canvas = byId("plane");
const point = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
canvas.addEventListener("pointerdown", (event) => {
  canvas.focus({ preventScroll: true }); // for the keys; what is prevented below would leave it without
  held = plane.handleAt(...point(event)) || { kind: "plane", from: point(event) };
  if (held) { canvas.setPointerCapture(event.pointerId); event.preventDefault(); }
});
canvas.addEventListener("pointermove", (event) => {
  if (!held) { canvas.style.cursor = plane.handleAt(...point(event)) ? "grab" : "default"; return; }
  const [px, py] = point(event), [x, y] = plane.place(px, py);
  if (held.kind === "plane") { plane.pan(px - held.from[0], py - held.from[1]); held.from = [px, py]; page.drawn = false; return; }
  if (held.kind === "target") { // the vehicle stays where it is, and its coordinates follow
    const [tx, ty] = page.targetPlace(), dx = x - tx, dy = y - ty;
    state.offset = [state.offset[0] + dx, state.offset[1] + dy];
    state.start[planeX] -= dx; state.start[planeY] -= dy;
  } else if (held.kind === "start") { const [i, j] = poses()[moved = held.pose].place; state.start[i] = x; state.start[j] = y; }
  else if (held.kind === "heading") {
    const { place: [i, j], heading } = poses()[moved = held.pose], [sx, sy] = plane.at(state.start[i], state.start[j]);
    state.start[heading] = Math.atan2(sy - py, px - sx);
  } else {
    const { cx, cy, size, most } = plane.dial, [a, b] = currentRows();
    let vx = ((px - cx) / size) * most, vy = ((cy - py) / size) * most;
    const speed = Math.hypot(vx, vy);
    if (speed > most) { vx *= most / speed; vy *= most / speed; }
    const within = (v, row) => Math.min(Math.max(v, -(data.most[row] ?? most)), data.most[row] ?? most);
    state.disturbance[a] = within(vx, a); state.disturbance[b] = within(vy, b);
  }
  changed();
});
for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, () => { held = null; });
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  plane.zoom(...point(event), Math.exp(0.0015 * event.deltaY));
  page.drawn = false;
}, { passive: false });
canvas.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return; // the browser's own keys
  const v = plane.view, step = event.shiftKey ? 0.002 : 0.01;
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const { place: [i, j], heading: own } = poses()[moved], heading = atHome() ? own : HEADING;
  if ("+=-".includes(event.key)) {
    plane.zoom((v.left + v.right) / 2, (v.top + v.bottom) / 2, event.key === "-" ? 1.25 : 0.8);
    page.drawn = false;
    event.preventDefault();
    return;
  }
  if (moves[event.key]) {
    state.start[i] += moves[event.key][0] * step * (v.x1 - v.x0);
    state.start[j] += moves[event.key][1] * step * (v.y1 - v.y0);
  } else if ((event.key === "[" || event.key === "]") && heading !== null) {
    state.start[heading] += (event.key === "[" ? 1 : -1) * step * 6;
  } else if (event.key === " ") play(!page.playing);
  else return;
  event.preventDefault();
  changed();
});
for (const kind of ["pointerdown", "pointermove"]) {
  byId("strips").addEventListener(kind, (event) => {
    if (kind === "pointermove" && event.buttons !== 1) return;
    page.time = strips.timeAt(event.clientX - byId("strips").getBoundingClientRect().left);
    byId("time").value = page.time;
    page.drawn = false;
  });
}
