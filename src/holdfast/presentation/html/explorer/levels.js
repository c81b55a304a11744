// The zero levels of the constraints and of the goal in the plane, at the other states of now.
"use strict";

const CELL = 7, MOST_LISTED = 8; // points of the canvas between nodes; names in the list

class Levels {
  constructor(page) {
    this.page = page;
    this.key = "";
    this.shown = [];
  }

  // What reads a state of the plane. Of a goal, what reads these states alone, where there is such.
  chosen() {
    const all = data.scene.filter((s) => s.kind === "ZeroLevel" && s.reads.some((k) => k === planeX || k === planeY));
    const flat = all.filter((s) => this.flat(s)), goal = (some) => some.filter((s) => s.role === "goal");
    return { constraints: all.filter((s) => s.role === "constraint"), goal: goal(flat).length ? goal(flat) : goal(all) };
  }
  flat(level) { return level.reads.every((k) => k === planeX || k === planeY); }

  // Lines and areas for a view of the plane, computed again where they move.
  of(plane, loop) {
    const { constraints, goal } = this.chosen(), levels = [...constraints, ...goal];
    if (!levels.length || !byId("levels").checked) return [];
    const now = this.page.stateAt(this.page.time), others = levels.flatMap((s) => s.reads).filter((k) => k !== planeX && k !== planeY);
    const { view } = plane, timed = levels.some((s) => s.timed) ? this.page.time : 0;
    const key = JSON.stringify([view, this.page.offset, planeX, planeY, others.map((k) => now[k]), timed, given()]);
    if (key === this.key) return this.shown;
    this.key = key;
    const nodes = (from, to) => Array.from({ length: Math.max(2, Math.ceil((to - from) / CELL) + 1) }, (_, k) => Math.min(from + k * CELL, to));
    const px = nodes(view.left, view.right), py = nodes(view.top, view.bottom);
    const xs = px.map((p) => plane.place(p, 0)[0]), ys = py.map((p) => plane.place(0, p)[1]);
    const values = loop.sceneOver(now, this.page.time, [planeX, xs], [planeY, ys], levels.map((s) => s.at));
    const most = (tables) => tables.reduce((a, b) => a.map((v, k) => Math.max(v, b[k])));
    const c = constraints.length, flat = values.filter((_, k) => k < c && this.flat(levels[k]));
    const small = (some, table, sign) => this.small(loop, now, some.map((s) => s.at), [px, py], [xs, ys], table, sign, plane);
    this.shown = constraints.map((s, k) => ({ role: s.role, number: k, flat: this.flat(s), ...cut(px, py, values[k]), area: null,
      mark: this.flat(s) ? small([s], values[k], -1) : null }));
    if (flat.length) this.shown.push({ role: "forbidden", area: cut(px, py, most(flat)).area });
    if (goal.length) {
      const table = most(values.slice(c)), isFlat = goal.every((s) => this.flat(s)), { lines } = cut(px, py, table);
      this.shown.push({ role: "goal", flat: isFlat, lines, area: isFlat ? cut(px, py, table.map((v) => -v)).area : null, mark: isFlat ? small(goal, table, 1) : null });
    }
    return this.shown;
  }

  // Where a set lies that is smaller than a cell, or null: the goal (sign 1), or an obstacle (-1).
  small(loop, now, at, [px, py], [xs, ys], table, sign, plane) {
    let best = 0, low = Infinity;
    table.forEach((v, k) => { if (sign * v < low) { low = sign * v; best = k; } });
    if (!(low > 0)) return null;
    let place = [px[best % px.length], py[Math.floor(best / px.length)]], wide = 1.5 * CELL;
    for (let turn = 0; turn < 8; turn++, wide /= 4) {
      const nodes = (from) => Array.from({ length: 11 }, (_, k) => from + wide * (k / 5 - 1)), [u, w] = place.map(nodes);
      const tables = loop.sceneOver(now, this.page.time, [planeX, u.map((p) => plane.place(p, 0)[0])], [planeY, w.map((p) => plane.place(0, p)[1])], at);
      let less = Infinity;
      for (let k = 0; k < tables[0].length; k++) {
        const v = sign * Math.max(...tables.map((t) => t[k]));
        if (v < less) { less = v; place = [u[k % 11], w[Math.floor(k / 11)]]; }
      }
      if (less <= 0) return place;
    }
    return null;
  }

  // The names, each with its line; of what depends on other states too, on which.
  list(look) {
    const { constraints, goal } = this.chosen();
    byId("levels").parentElement.hidden = !constraints.length && !goal.length;
    const label = (s) => {
      const others = s.reads.filter((k) => k !== planeX && k !== planeY).map((k) => data.states[k].name);
      return s.name.replaceAll("_", " ") + (others.length ? `, at ${others.join(", ")} of now` : "");
    };
    const items = constraints.slice(0, MOST_LISTED).map((s, k) => marked(look.constraint, label(s), look.dashes[k % look.dashes.length]));
    if (constraints.length > MOST_LISTED) items.push(marked(look.constraint, `and ${constraints.length - MOST_LISTED} more`));
    if (goal.length) items.push(marked(look.goal, goal.every((s) => this.flat(s)) ? "goal" : label({ ...goal[0], name: "goal" }), GOAL_DASH));
    byId("lines").replaceChildren(...(byId("levels").checked ? items : []));
  }
}

const GOAL_DASH = [4, 2];

// Of a table over nodes: the pieces of its zero level, and polygons of where it is above 0.
function cut(xs, ys, values) {
  const lines = [], area = [], across = xs.length;
  for (let r = 0; r + 1 < ys.length; r++) {
    let from = null; // a row of whole cells is one polygon
    const close = (to) => { if (from !== null) area.push([[from, ys[r]], [to, ys[r]], [to, ys[r + 1]], [from, ys[r + 1]]]); from = null; };
    for (let q = 0; q + 1 < across; q++) {
      const k = r * across + q, v = values[k], right = values[k + 1], below = values[k + across], far = values[k + across + 1];
      const whole = Number.isFinite(v + right + below + far);
      if (whole && v > 0 && right > 0 && below > 0 && far > 0) { from ??= xs[q]; continue; }
      close(xs[q]);
      if (!whole || !(v > 0 || right > 0 || below > 0 || far > 0)) continue;
      const corners = [[xs[q], ys[r], v], [xs[q + 1], ys[r], right], [xs[q + 1], ys[r + 1], far], [xs[q], ys[r + 1], below]];
      const polygon = [], ends = [];
      corners.forEach((a, side) => {
        const b = corners[(side + 1) % 4];
        if (a[2] > 0) polygon.push([a[0], a[1]]);
        if ((a[2] > 0) === (b[2] > 0)) return;
        const part = a[2] / (a[2] - b[2]), end = [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])];
        polygon.push(end); ends.push(end);
      });
      area.push(polygon);
      for (let e = 0; e + 1 < ends.length; e += 2) lines.push([ends[e], ends[e + 1]]);
    }
    close(xs[across - 1]);
  }
  return { lines: joined(lines), area };
}

// Pieces that share an end become one line, so that dashes run along it.
function joined(pieces) {
  const key = ([x, y]) => `${Math.round(64 * x)},${Math.round(64 * y)}`, at = new Map(), free = new Set(pieces);
  for (const piece of pieces) for (const end of piece) at.set(key(end), [...(at.get(key(end)) || []), piece]);
  const lines = [];
  for (const first of pieces) {
    if (!free.delete(first)) continue;
    const line = [...first];
    for (const ahead of [true, false]) {
      for (;;) {
        const end = ahead ? line.at(-1) : line[0], next = (at.get(key(end)) || []).find((piece) => free.has(piece));
        if (!next) break;
        free.delete(next);
        const other = key(next[0]) === key(end) ? next[1] : next[0];
        if (ahead) line.push(other); else line.unshift(other);
      }
    }
    lines.push(line);
  }
  return lines;
}
