// The value of the law in the plane, at the other states of an instant.
"use strict";

function slices(loop, grid) {
  if (!grid) return null;
  const of = { float32: Float32Array, float64: Float64Array }[grid.type];
  const values = new of(loop.table.buffer, loop.table.byteOffset, loop.table.byteLength / of.BYTES_PER_ELEMENT);
  const axes = grid.states, last = axes.length, strides = grid.shape.map((_, i) => grid.shape.slice(i + 1).reduce((a, b) => a * b, 1));
  const timed = grid.shape.length - last;
  return (now, left) => {
    const weights = axes.map((s, i) => s === planeX || s === planeY ? null : near(i, now[s]));
    const time = timed ? near(-1, left) : null;
    return (x, y) => {
      let total = 0;
      const parts = axes.map((s, i) => (s === planeX ? near(i, x) : s === planeY ? near(i, y) : weights[i]));
      if (time) parts.unshift(time);
      if (parts.some((p) => !p)) return NaN;
      for (let corner = 0; corner < 1 << parts.length; corner++) {
        let weight = 1, at = 0;
        parts.forEach((p, i) => { const up = corner >> i & 1; weight *= up ? p.part : 1 - p.part; at += strides[i] * (up ? p.next : p.node); });
        if (weight) total += weight * values[at];
      }
      return total;
    };
  };
  function near(axis, value) {
    const i = axis + timed, count = grid.shape[i];
    let q = (value - grid.low[i]) / grid.steps[i];
    if (grid.periodic[i]) q -= count * Math.floor(q / count);
    else if (i < timed) q = Math.min(Math.max(q, 0), count - 1);
    else if (!(q >= 0 && q <= count - 1)) return null;
    const node = Math.min(Math.floor(q), grid.periodic[i] ? count - 1 : count - 2);
    return { node, next: (node + 1) % count, part: q - node };
  }
}
