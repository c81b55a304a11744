// The plane: scene, paths, vehicle, view, the set of the law's value, and handles to drag.
"use strict";

const PAD = 0.06, TICKS = 6, HANDLE = 9;

const ANGLES = [1, 2, 5, 10, 15, 30, 45, 90, 180]; // degrees between ticks

function niceStep(span, count, angle = false) {
  const raw = span / count;
  if (angle && raw > 0.7 && raw <= 180) return ANGLES.find((step) => step >= 0.9 * raw) || 180;
  const power = 10 ** Math.floor(Math.log10(raw)), rest = raw / power;
  return power * (rest < 1.5 ? 1 : rest < 3.5 ? 2 : rest < 7.5 ? 5 : 10);
}

function short(value) {
  const text = Math.abs(value) < 1e-12 ? "0" : String(Number(value.toPrecision(4)));
  return text.replace("-", "\u2212");
}

// Dashes in widths of a line, on the canvas.
function dashed(pattern, width) { return pattern.map((part) => part * width); }

// Whether a shape is a vehicle with trailers, or one of these.
function isBody({ role }) { return role === "vehicle" || role === "trailer"; }

// The unit in which a number is read, and the factor to it: an angle is read in degrees.
function shownUnit(unit) { return unit === "rad" ? ["deg", 180 / Math.PI] : [unit, 1]; }

class Plane {
  constructor(canvas, page) {
    this.canvas = canvas;
    this.page = page;
    this.screen = this.context = canvas.getContext("2d");
    this.box = null; // {x0, x1, y0, y1} in the units of the states
    this.handles = [];
  }

  // Everything that shall be seen: starts and fixed shapes.
  fit(points) {
    let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
    for (const [x, y] of points) {
      if (!Number.isFinite(x) || !Number.isFinite(y)) continue;
      x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y);
    }
    if (!(x1 >= x0)) [x0, x1, y0, y1] = [-1, 1, -1, 1];
    const pad = PAD * Math.max(x1 - x0, y1 - y0, 0.1) + 0.02;
    this.box = { x0: x0 - pad, x1: x1 + pad, y0: y0 - pad, y1: y1 + pad };
  }

  pan(dx, dy) {
    const { view: v, box } = this;
    box.x0 -= dx / v.sx; box.x1 -= dx / v.sx; box.y0 += dy / v.sy; box.y1 += dy / v.sy;
  }

  // By a factor around a place on the canvas.
  zoom(px, py, factor) {
    const [x, y] = this.place(px, py), [ox, oy] = this.page.offset, { box } = this;
    for (const [k, at] of [["x0", x + ox], ["x1", x + ox], ["y0", y + oy], ["y1", y + oy]]) box[k] = at + factor * (box[k] - at);
  }

  // The size of the canvas in points, its scale, and where the plane is on it.
  arrange() {
    const { canvas, box } = this, ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const left = 48, right = 10, top = 10, bottom = 40;
    let sx = (width - left - right) / (box.x1 - box.x0), sy = (height - top - bottom) / (box.y1 - box.y0);
    if (this.page.equal) sx = sy = Math.min(sx, sy);
    const wide = (width - left - right) / sx, high = (height - top - bottom) / sy;
    const cx = (box.x0 + box.x1) / 2, cy = (box.y0 + box.y1) / 2;
    this.view = { left, top, right: width - right, bottom: height - bottom, sx, sy,
      x0: cx - wide / 2, x1: cx + wide / 2, y0: cy - high / 2, y1: cy + high / 2, width, height };
  }

  // On the canvas, of the coordinates of the states, which move with the target.
  at(x, y) {
    const v = this.view, [ox, oy] = this.page.offset;
    return [v.left + (x + ox - v.x0) * v.sx, v.bottom - (y + oy - v.y0) * v.sy];
  }
  place(px, py) {
    const v = this.view, [ox, oy] = this.page.offset;
    return [v.x0 + (px - v.left) / v.sx - ox, v.y0 + (v.bottom - py) / v.sy - oy];
  }

  // context: another one that is drawn on, for a file without handles.
  draw(context = null) {
    if (!this.box) return;
    if (context === null) this.arrange();
    this.context = context || this.screen;
    this.paint();
    this.context = this.screen;
    if (context !== null || this.page.printing) return;
    this.startHandles();
    this.targetHandle();
    this.currentHandle();
  }

  paint() {
    const { context: c, page, view } = this, look = page.colours();
    this.look = look;
    this.handles = [];
    c.clearRect(0, 0, view.width, view.height);
    this.axes();
    c.save();
    c.beginPath();
    c.rect(view.left, view.top, view.right - view.left, view.bottom - view.top);
    c.clip();
    if (page.slice) this.set(page.slice);
    this.levels(page.levelsOf(this));
    this.shapes(page.sceneNow, true);
    if (c === this.screen) this.layer(); else this.fan();
    this.shapes(page.sceneNow, false);
    if (page.run) { this.others(page.run); this.path(page.run); }
    this.vehicles();
    c.restore();
  }

  axes() {
    const { context: c, view: v, look, page } = this;
    c.strokeStyle = look.line; c.fillStyle = look.soft; c.lineWidth = 1;
    c.font = "12px system-ui, sans-serif";
    const [[ux, kx], [uy, ky]] = [page.axisUnit(0), page.axisUnit(1)], step = (span, unit, k) => niceStep(span * k, TICKS, unit === "deg") / k;
    const sx = step(v.x1 - v.x0, ux, kx), sy = this.page.equal ? sx : step(v.y1 - v.y0, uy, ky);
    c.textAlign = "center"; c.textBaseline = "top";
    const [ox, oy] = page.offset; // ticks are coordinates of the states
    for (let x = Math.ceil((v.x0 - ox) / sx) * sx; x + ox <= v.x1 + 1e-9; x += sx) {
      const [px] = this.at(x, 0);
      c.beginPath(); c.moveTo(px, v.top); c.lineTo(px, v.bottom); c.stroke();
      c.fillText(short(x * kx), px, v.bottom + 5);
    }
    c.textAlign = "right"; c.textBaseline = "middle";
    for (let y = Math.ceil((v.y0 - oy) / sy) * sy; y + oy <= v.y1 + 1e-9; y += sy) {
      const [, py] = this.at(0, y);
      c.beginPath(); c.moveTo(v.left, py); c.lineTo(v.right, py); c.stroke();
      c.fillText(short(y * ky), v.left - 6, py);
    }
    c.fillStyle = look.text; c.textAlign = "center"; c.textBaseline = "bottom";
    c.fillText(page.axisLabel(0), (v.left + v.right) / 2, v.height - 4);
    c.save();
    c.translate(12, (v.top + v.bottom) / 2); c.rotate(-Math.PI / 2); c.textBaseline = "middle";
    c.fillText(page.axisLabel(1), 0, 0);
    c.restore();
  }

  line(xy, colour, width, alpha = 1, dash = []) {
    const { context: c } = this;
    c.strokeStyle = colour; c.lineWidth = width; c.globalAlpha = alpha; c.setLineDash(dash);
    c.lineJoin = "round";
    c.beginPath();
    for (let k = 0; k + 1 < xy.length; k += 2) {
      const [px, py] = this.at(xy[k], xy[k + 1]);
      if (k) c.lineTo(px, py); else c.moveTo(px, py);
    }
    c.stroke();
    c.globalAlpha = 1; c.setLineDash([]);
  }

  cross([x, y], colour) {
    const { context: c } = this, [px, py] = this.at(x, y);
    c.strokeStyle = colour; c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(px - 4, py - 4); c.lineTo(px + 4, py + 4); c.moveTo(px + 4, py - 4); c.lineTo(px - 4, py + 4);
    c.stroke();
  }

  // All paths, the rarest outcome on top.
  fan() {
    const { page, look } = this, counts = {};
    for (const { outcome } of page.fan) counts[outcome] = (counts[outcome] || 0) + 1;
    const sorted = [...page.fan].sort((a, b) => counts[b.outcome] - counts[a.outcome]);
    for (const path of sorted) this.line(path.xy, look.outcomes[path.outcome], 1, 0.55, look.dashesOf(path.outcome, 1.4));
    for (const path of sorted) if (path.left) this.cross(path.left, look.text);
  }

  // They are drawn once, and copied until they or the view change.
  layer() {
    const { page, canvas, view, look } = this;
    const key = JSON.stringify([page.fan.length, page.fanNumber, view, page.offset, look.text, canvas.width]);
    this.kept ??= document.createElement("canvas");
    if (this.keptKey !== key) {
      this.keptKey = key;
      [this.kept.width, this.kept.height] = [canvas.width, canvas.height];
      this.context = this.kept.getContext("2d");
      this.context.setTransform(this.screen.getTransform());
      this.fan();
      this.context = this.screen;
    }
    this.context.drawImage(this.kept, 0, 0, view.width, view.height);
  }

  // The paths of the other vehicles of a run.
  others(run) {
    const n = this.page.data.states.length;
    for (const { place: [i, j] } of poses().slice(1)) {
      const xy = [];
      for (let k = 0; k < run.count; k++) xy.push(run.state[k * n + i], run.state[k * n + j]);
      this.line(xy, this.look.soft, 1.5, 0.8);
    }
  }

  // One run, coloured by its mode.
  path(run) {
    const { page, look } = this, [i, j] = page.data.plane, n = page.data.states.length;
    let piece = [], mode = run.mode ? run.mode[0] : 0;
    const flush = () => {
      this.line(piece, look.page, 5.5);
      this.line(piece, look.modes[mode % look.modes.length], 3, 1, dashed(look.dashes[mode % look.dashes.length], 2.4));
    };
    for (let k = 0; k < run.count; k++) {
      const x = run.state[k * n + i], y = run.state[k * n + j];
      piece.push(x, y);
      const now = run.mode ? run.mode[k] : 0;
      if (now !== mode) { flush(); piece = [x, y]; mode = now; }
    }
    flush();
    if (run.ended === "LEFT" || run.ended === "DIVERGED") {
      const last = Math.min(run.count - 1, Math.floor(run.exitTime / page.recordEvery));
      this.cross([run.state[last * n + i], run.state[last * n + j]], look.text);
    }
  }

  // What is forbidden and the goal, below everything, and the lines around them.
  levels(shown) {
    const { context: c, look } = this;
    for (const { role, area } of shown) {
      if (!area) continue;
      c.fillStyle = role === "goal" ? look.goalArea : look.forbidden;
      c.beginPath();
      for (const [[x, y], ...others] of area) { c.moveTo(x, y); for (const p of others) c.lineTo(...p); c.closePath(); }
      c.fill();
    }
    for (const { role, number, lines, flat, mark } of shown) {
      if (!lines) continue;
      const width = flat ? 1.6 : 1;
      c.strokeStyle = role === "goal" ? look.goal : look.constraint; c.lineWidth = width;
      c.setLineDash(dashed(role === "goal" ? GOAL_DASH : look.dashes[number % look.dashes.length], width));
      for (const [[x, y], ...others] of lines) { c.beginPath(); c.moveTo(x, y); for (const p of others) c.lineTo(...p); c.stroke(); }
      if (!mark) continue;
      const [x, y] = mark;
      c.setLineDash([]); c.lineWidth = 2.5;
      c.beginPath(); c.moveTo(x - 7, y); c.lineTo(x + 7, y); c.moveTo(x, y - 7); c.lineTo(x, y + 7); c.stroke();
    }
    c.setLineDash([]);
  }

  // Walls, targets, goals, views, bodies: `fill` draws the areas, which lie below the paths.
  shapes(numbers, fill) {
    if (!numbers) return;
    const { context: c, look, page } = this;
    for (const { kind, role, at } of page.data.scene) {
      const v = numbers.subarray(at);
      c.lineWidth = role === "target" ? 5 : 1.6;
      c.strokeStyle = page.data.look.walls.includes(role) ? look.wall : role === "goals" ? look.goals : look.text;
      if (kind === "Segment" && !fill) {
        this.line([v[0], v[1], v[2], v[3]], c.strokeStyle, c.lineWidth);
      } else if (kind === "Circle" && !fill) {
        const [px, py] = this.at(v[0], v[1]);
        c.setLineDash(role === "goals" ? [5, 4] : []);
        c.beginPath();
        c.ellipse(px, py, Math.max(v[2] * this.view.sx, 0), Math.max(v[2] * this.view.sy, 0), 0, 0, 2 * Math.PI);
        c.stroke(); c.setLineDash([]);
      } else if ((kind === "Cone" || kind === "Footprint") && fill !== isBody({ role })) {
        this.seen(kind, v, page.data.scene, at, numbers.length);
      }
    }
  }

  seen(kind, v, scene, at, length) {
    const { context: c, look } = this;
    const corners = [];
    if (kind === "Cone") {
      const [x, y, heading, half, range] = v;
      if (!(range > 0 && Number.isFinite(range + heading + half))) return;
      corners.push([x, y]);
      for (let k = 0; k <= 24; k++) {
        const angle = heading - half + (2 * half * k) / 24;
        corners.push([x + range * Math.cos(angle), y + range * Math.sin(angle)]);
      }
    } else {
      const next = Math.min(length, ...scene.map((s) => s.at).filter((k) => k > at));
      const [x, y, heading] = v, count = (next - at - 3) / 2;
      for (let k = 0; k < count; k++) {
        const a = v[3 + 2 * k], b = v[4 + 2 * k];
        corners.push([x + a * Math.cos(heading) - b * Math.sin(heading), y + a * Math.sin(heading) + b * Math.cos(heading)]);
      }
    }
    c.beginPath();
    corners.forEach(([x, y], k) => { const p = this.at(x, y); if (k) c.lineTo(...p); else c.moveTo(...p); });
    c.closePath();
    const body = isBody(scene.find((s) => s.at === at));
    c.fillStyle = body ? look.soft : look.view; c.globalAlpha = body ? 0.6 : 0.22; c.fill(); c.globalAlpha = 1;
    c.strokeStyle = body ? look.text : look.soft; c.lineWidth = body ? 1.4 : 0.8; c.stroke();
  }

  vehicles() {
    for (const { x, y, heading } of this.page.posesNow()) this.vehicle(x, y, heading, this.look.text, 1);
  }

  vehicle(x, y, heading, colour, alpha) {
    const { context: c } = this, [px, py] = this.at(x, y);
    c.save();
    c.translate(px, py);
    c.globalAlpha = alpha;
    c.fillStyle = colour;
    c.strokeStyle = this.look.page;
    c.beginPath();
    if (heading === null) c.arc(0, 0, 6, 0, 2 * Math.PI);
    else {
      c.rotate(-heading);
      c.moveTo(13, 0); c.lineTo(-8, 7); c.lineTo(-4, 0); c.lineTo(-8, -7); c.closePath();
    }
    c.fill(); c.lineWidth = 1; c.stroke();
    c.restore();
  }

  // -- handles ---------------------------------------------------------------------------------

  startHandles() {
    this.page.startPoses().forEach((pose, k) => this.startHandle(pose, k));
  }

  startHandle(pose, number) {
    const { context: c, look } = this, [px, py] = this.at(pose.x, pose.y);
    this.dot(px, py, look.accent, pose.label, true);
    this.handles.push({ kind: "start", pose: number, px, py });
    if (pose.heading === null) return;
    const hx = px + 34 * Math.cos(pose.heading), hy = py - 34 * Math.sin(pose.heading);
    c.strokeStyle = look.accent; c.lineWidth = 2;
    c.beginPath(); c.moveTo(px, py); c.lineTo(hx, hy); c.stroke();
    this.dot(hx, hy, look.accent, "");
    this.handles.push({ kind: "heading", pose: number, px: hx, py: hy });
  }

  dot(px, py, colour, label, hollow = false) {
    const { context: c, look } = this;
    c.beginPath(); c.arc(px, py, HANDLE - 2, 0, 2 * Math.PI);
    if (!hollow) { c.fillStyle = look.page; c.fill(); }
    c.strokeStyle = colour; c.lineWidth = 2.5; c.stroke();
    if (!label) return;
    c.font = "12px system-ui, sans-serif"; c.fillStyle = look.text;
    c.textAlign = "center"; c.textBaseline = "bottom";
    c.lineWidth = 3; c.strokeStyle = look.page;
    c.strokeText(label, px, py - HANDLE - 2); c.fillText(label, px, py - HANDLE - 2);
  }

  targetHandle() {
    const place = this.page.targetPlace();
    if (!place) return;
    const [px, py] = this.at(...place);
    this.dot(px, py, this.look.text, "");
    this.handles.push({ kind: "target", px, py });
  }

  // The current as an arrow from the middle of a dial in the corner.
  currentHandle() {
    const { context: c, page, look, view } = this, current = page.current();
    if (!current) return;
    const size = 38, cx = view.right - size - 8, cy = view.top + size + 18;
    this.dial = { cx, cy, size, most: current.most };
    c.globalAlpha = 0.85; c.fillStyle = look.card;
    c.beginPath(); c.arc(cx, cy, size, 0, 2 * Math.PI); c.fill(); c.globalAlpha = 1;
    c.strokeStyle = look.line; c.lineWidth = 1; c.stroke();
    c.font = "12px system-ui, sans-serif"; c.fillStyle = look.text; c.textAlign = "center"; c.textBaseline = "bottom";
    c.fillText(`current ${short(Math.hypot(...current.value))} ${current.unit}`, cx, cy - size - 3);
    const [vx, vy] = current.value, hx = cx + (vx / current.most) * size, hy = cy - (vy / current.most) * size;
    c.strokeStyle = look.current; c.lineWidth = 3;
    c.beginPath(); c.moveTo(cx, cy); c.lineTo(hx, hy); c.stroke();
    this.dot(hx, hy, look.current, "");
    this.handles.push({ kind: "current", px: hx, py: hy });
  }

  handleAt(px, py) {
    let best = null, least = 22 ** 2;
    for (const handle of this.handles) {
      const distance = (handle.px - px) ** 2 + (handle.py - py) ** 2;
      if (distance < least) { best = handle; least = distance; }
    }
    return best;
  }

  // -- the set where the value of the law is above zero, in the slice of the other states -------

  set(slice) {
    const { context: c, view: v, look } = this, step = 2, columns = [];
    c.fillStyle = look.set;
    for (let px = v.left; px < v.right; px += step) columns.push(slice.across(this.place(px + step / 2, 0)[0]));
    for (let py = v.top; py < v.bottom; py += step) {
      const row = slice.up(this.place(0, py + step / 2)[1]);
      let from = null;
      for (let px = v.left, k = 0; k <= columns.length; px += step, k++) {
        const inside = k < columns.length && slice.of(columns[k], row) > 0;
        if (inside && from === null) from = px;
        if (!inside && from !== null) { c.fillRect(from, py, px - from, step); from = null; }
      }
    }
  }
}
