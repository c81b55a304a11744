// Histories of the run: constraints, inputs and what the safety filter changed, over time.
"use strict";

const SAMPLE = 22; // of a line, beside its name

class Strips {
  constructor(canvas, page) {
    this.canvas = canvas;
    this.page = page;
    this.context = canvas.getContext("2d");
  }

  // Groups of lines: { title, unit, lines: [{ name, colour, values: k -> number, dash }], limit, scale: to the
  // unit of the title }.
  draw(groups, horizon, now) {
    const { canvas, context: c, page } = this, ratio = window.devicePixelRatio || 1;
    const left = 54, right = 10, bottom = 34, row = 16, count = groups.length;
    if (!count) return;
    c.font = "12px system-ui, sans-serif";
    const rows = groups.map((group) => this.rows(group, left, canvas.clientWidth - right));
    const legends = rows.reduce((sum, own) => sum + row * (own.at(-1).row + 1) + 8, 0);
    canvas.style.height = `${count * 84 + legends + bottom}px`;
    const width = canvas.clientWidth, height = canvas.clientHeight, look = page.colours();
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    const high = Math.max((height - bottom - legends) / count, 20);
    this.area = { left, right: width - right, horizon };
    const px = (t) => left + (t / horizon) * (width - left - right);
    let top = 0;
    groups.forEach((group, g) => {
      top += row * (rows[g].at(-1).row + 1) + 8;
      this.group(group, top, high, px, width - right, look, rows[g]);
      top += high;
    });
    const end = height - bottom, step = niceStep(horizon, 6);
    c.fillStyle = look.soft; c.font = "12px system-ui, sans-serif"; c.textAlign = "center"; c.textBaseline = "top";
    for (let t = 0; t <= horizon + 1e-9; t += step) c.fillText(short(t), px(t), end + 4);
    c.fillStyle = look.text;
    c.fillText("time [s]", (left + width - right) / 2, height - 15);
    c.strokeStyle = look.text; c.lineWidth = 1;
    c.beginPath(); c.moveTo(px(now), 14); c.lineTo(px(now), end); c.stroke();
  }

  // Where the title and the names of lines stand above a group: row 0 is the first.
  rows(group, left, right) {
    const { context: c } = this, found = [{ text: group.title, x: left, row: 0 }];
    let x = left + c.measureText(group.title).width + 12, row = 0;
    for (const line of group.lines) {
      const wide = SAMPLE + 4 + c.measureText(line.name).width + 12;
      if (x + wide > right && x > left) { x = left; row += 1; }
      found.push({ text: line.name, x, row });
      x += wide;
    }
    return found;
  }

  group(group, top, high, px, right, look, rows) {
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
    const scale = group.scale ?? 1, step = niceStep(scale * (most - low), high < 70 ? 2 : 3, scale !== 1) / scale;
    for (let v = Math.ceil(low / step) * step; v <= most + 1e-9; v += step) c.fillText(short(scale * v), left - 5, py(v));
    if (group.limit !== undefined) {
      c.strokeStyle = look.limit; c.setLineDash([4, 3]);
      c.beginPath(); c.moveTo(left, py(group.limit)); c.lineTo(right, py(group.limit)); c.stroke(); c.setLineDash([]);
    }
    const first = top - 16 * rows.at(-1).row;
    c.textAlign = "left"; c.textBaseline = "bottom"; c.fillStyle = look.text;
    c.fillText(group.title, left, first - 4);
    group.lines.forEach((line, number) => {
      c.strokeStyle = line.colour; c.lineWidth = 1.6; c.setLineDash(line.dash || []);
      c.beginPath();
      let drawn = false;
      for (let k = 0; k < run.count; k++) {
        const v = line.values(k);
        if (!Number.isFinite(v)) { drawn = false; continue; }
        const x = px(k * page.recordEvery);
        if (drawn && line.steps) c.lineTo(x, py(line.values(k - 1)));
        if (drawn) c.lineTo(x, py(v)); else c.moveTo(x, py(v));
        drawn = true;
      }
      c.stroke(); c.setLineDash([]);
      const { x, row } = rows[number + 1], y = first + 16 * row;
      c.lineWidth = 2; c.setLineDash(line.dash || []);
      c.beginPath(); c.moveTo(x, y - 10); c.lineTo(x + SAMPLE, y - 10); c.stroke(); c.setLineDash([]);
      c.fillStyle = look.text; c.fillText(line.name, x + SAMPLE + 4, y - 4);
    });
  }

  timeAt(px) {
    const { left, right, horizon } = this.area || { left: 0, right: 1, horizon: 1 };
    return Math.min(Math.max(((px - left) / (right - left)) * horizon, 0), horizon);
  }
}
