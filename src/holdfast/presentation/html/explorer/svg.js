// A drawing context that writes SVG: the operations that the plane and the strips use.
"use strict";

class SvgContext {
  constructor(width, height) {
    this.size = [width, height];
    this.parts = [];
    this.clips = [];
    this.matrix = [1, 0, 0, 1, 0, 0];
    this.state = { clip: "" };
    this.stack = [];
    this.points = "";
    Object.assign(this, { strokeStyle: "#000", fillStyle: "#000", lineWidth: 1, globalAlpha: 1, font: "12px sans-serif",
      textAlign: "left", textBaseline: "alphabetic", lineJoin: "miter" });
    this.dash = [];
    this.measure = document.createElement("canvas").getContext("2d");
  }

  at(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    return `${(a * x + c * y + e).toFixed(2)} ${(b * x + d * y + f).toFixed(2)}`;
  }
  save() {
    const { matrix, strokeStyle, fillStyle, lineWidth, globalAlpha, font, textAlign, textBaseline, dash } = this;
    this.stack.push({ matrix, strokeStyle, fillStyle, lineWidth, globalAlpha, font, textAlign, textBaseline, dash, state: { ...this.state } });
  }
  restore() { Object.assign(this, this.stack.pop()); }
  setTransform() { this.matrix = [1, 0, 0, 1, 0, 0]; }
  clearRect() {}
  times([a, b, c, d, e, f]) {
    const [A, B, C, D, E, F] = this.matrix;
    this.matrix = [A * a + C * b, B * a + D * b, A * c + C * d, B * c + D * d, A * e + C * f + E, B * e + D * f + F];
  }
  translate(x, y) { this.times([1, 0, 0, 1, x, y]); }
  rotate(angle) { this.times([Math.cos(angle), Math.sin(angle), -Math.sin(angle), Math.cos(angle), 0, 0]); }
  setLineDash(dash) { this.dash = dash; }
  beginPath() { this.points = ""; }
  moveTo(x, y) { this.points += `M${this.at(x, y)}`; }
  lineTo(x, y) { this.points += `L${this.at(x, y)}`; }
  closePath() { this.points += "Z"; }
  rect(x, y, w, h) { this.moveTo(x, y); this.lineTo(x + w, y); this.lineTo(x + w, y + h); this.lineTo(x, y + h); this.closePath(); }
  arc(x, y, r) { this.ellipse(x, y, r, r); }
  ellipse(x, y, rx, ry) {
    this.points += `M${this.at(x - rx, y)}A${rx} ${ry} 0 1 0 ${this.at(x + rx, y)}A${rx} ${ry} 0 1 0 ${this.at(x - rx, y)}Z`;
  }
  clip() {
    this.clips.push(this.points);
    this.state = { clip: ` clip-path="url(#c${this.clips.length})"` };
  }
  add(element) { this.parts.push(element); }
  stroke() {
    const dash = this.dash.length ? ` stroke-dasharray="${this.dash.join(" ")}"` : "";
    this.add(`<path d="${this.points}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-opacity="${this.globalAlpha}" stroke-linejoin="${this.lineJoin}"${dash}${this.state.clip}/>`);
  }
  fill() {
    this.add(`<path d="${this.points}" fill="${this.fillStyle}" fill-opacity="${this.globalAlpha}"${this.state.clip}/>`);
  }
  strokeRect(...box) { this.beginPath(); this.rect(...box); this.stroke(); }
  fillRect(...box) { this.beginPath(); this.rect(...box); this.fill(); }
  measureText(text) { this.measure.font = this.font; return this.measure.measureText(text); }
  fillText(text, x, y) {
    const anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
    const base = { top: "hanging", middle: "central", bottom: "text-after-edge", alphabetic: "alphabetic" }[this.textBaseline];
    const safe = String(text).replace(/[&<>]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[c]);
    const m = this.matrix.map((v) => v.toFixed(4)).join(" ");
    this.add(`<text transform="matrix(${m})" x="${x.toFixed(2)}" y="${y.toFixed(2)}" fill="${this.fillStyle}" text-anchor="${anchor}" dominant-baseline="${base}" style="font:${this.font}">${safe}</text>`);
  }

  text(background) {
    const [w, h] = this.size, clips = this.clips.map((d, k) => `<clipPath id="c${k + 1}"><path d="${d}"/></clipPath>`).join("");
    return `<svg xmlns="http://www.w3.org/2000/svg" width="${w}" height="${h}" viewBox="0 0 ${w} ${h}"><defs>${clips}</defs>`
      + `<rect width="${w}" height="${h}" fill="${background}"/>${this.parts.join("")}</svg>`;
  }
}
