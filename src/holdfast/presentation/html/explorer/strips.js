// Histories of the run: constraints, inputs and what the safety filter changed, over time.
"use strict";

class Strips {
  constructor(canvas, page) {
    this.canvas = canvas;
    this.page = page;
    this.context = canvas.getContext("2d");
  }

  // Groups of lines: { title, unit, lines: [{ name, colour, values: k -> number, dash }], limit }.
  draw(groups, horizon, now) {
    const { canvas, context: c, page } = this, ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight, look = page.colours();
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    const left = 54, right = 10, bottom = 34, gap = 24, count = groups.length;
    if (!count) return;
    const high = (height - bottom - gap * count) / count;
    this.area = { left, right: width - right, horizon };
    const px = (t) => left + (t / horizon) * (width - left - right);
    groups.forEach((group, g) => {
      const top = gap + g * (high + gap);
      this.group(group, top, high, px, width - right, look);
    });
    const end = height - bottom, step = niceStep(horizon, 6);
    c.fillStyle = look.soft; c.font = "12px system-ui, sans-serif"; c.textAlign = "center"; c.textBaseline = "top";
    for (let t = 0; t <= horizon + 1e-9; t += step) c.fillText(short(t), px(t), end + 4);
    c.fillStyle = look.text;
    c.fillText("time [s]", (left + width - right) / 2, height - 15);
    c.strokeStyle = look.text; c.lineWidth = 1;
    c.beginPath(); c.moveTo(px(now), gap - 6); c.lineTo(px(now), end); c.stroke();
  }

  group(group, top, high, px, right, look) {
    const { context: c, page } = this, run = page.run, left = this.area.left;
    let low = group.limit ?? Infinity, most = group.limit ?? -Infinity;
    for (const line of group.lines) {
      for (let k = 0; k < run.count; k++) {
        const v = line.values(k);
        if (Number.isFinite(v)) { low = Math.min(low, v); most = Math.max(most, v); }
      }
    }
    if (!(most > low)) { low -= 0.5; most += 0.5; }
    const pad = 0.06 * (most - low), py = (v) => top + high - ((v - low + pad) / (most - low + 2 * pad)) * high;
    c.strokeStyle = look.line; c.lineWidth = 1; c.strokeRect(left, top, right - left, high);
    c.font = "12px system-ui, sans-serif"; c.fillStyle = look.soft; c.textAlign = "right"; c.textBaseline = "middle";
    const step = niceStep(most - low, 3);
    for (let v = Math.ceil(low / step) * step; v <= most + 1e-9; v += step) c.fillText(short(v), left - 5, py(v));
    if (group.limit !== undefined) {
      c.strokeStyle = look.limit; c.setLineDash([4, 3]);
      c.beginPath(); c.moveTo(left, py(group.limit)); c.lineTo(right, py(group.limit)); c.stroke(); c.setLineDash([]);
    }
    let x = left;
    c.textAlign = "left"; c.textBaseline = "bottom"; c.fillStyle = look.text;
    c.fillText(group.title, x, top - 4);
    x += c.measureText(group.title).width + 12;
    for (const line of group.lines) {
      c.strokeStyle = line.colour; c.lineWidth = 1.6; c.setLineDash(line.dash || []);
      c.beginPath();
      let drawn = false;
      for (let k = 0; k < run.count; k++) {
        const v = line.values(k);
        if (!Number.isFinite(v)) { drawn = false; continue; }
        if (drawn) c.lineTo(px(k * page.recordEvery), py(v)); else c.moveTo(px(k * page.recordEvery), py(v));
        drawn = true;
      }
      c.stroke(); c.setLineDash([]);
      if (x < right - 40) {
        c.fillStyle = line.colour; c.fillRect(x, top - 11, 12, 3);
        c.fillStyle = look.text; c.fillText(line.name, x + 16, top - 4);
        x += 16 + c.measureText(line.name).width + 12;
      }
    }
  }

  timeAt(px) {
    const { left, right, horizon } = this.area || { left: 0, right: 1, horizon: 1 };
    return Math.min(Math.max(((px - left) / (right - left)) * horizon, 0), horizon);
  }
}
