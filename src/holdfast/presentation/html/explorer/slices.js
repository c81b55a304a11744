// The value of a set in the plane, at the other states and the time of an instant.
"use strict";

const ROUNDED = 1e-9; // of a step: the ends of a grid are on it
const TYPES = { float32: Float32Array, float64: Float64Array, int8: Int8Array };

// The values of a law's table, as it lies in the memory of its loop.
function ofLaw(loop, grid) {
  if (!grid) return null;
  const Type = TYPES[grid.type], { table } = loop;
  return slices(new Type(table.buffer, table.byteOffset, table.byteLength / Type.BYTES_PER_ELEMENT), grid);
}

// The values of a set without a law: a byte for each node, at one time after the other.
async function ofSet({ values, times, shape, low, steps, periodic }) {
  const parts = await Promise.all(values.map(unpacked)), size = parts[0].length;
  const all = new Int8Array(size * parts.length);
  parts.forEach((part, k) => all.set(new Int8Array(part.buffer, part.byteOffset, size), k * size));
  return slices(all, { states: shape.map((_, i) => i), times, periodic: [false, ...periodic],
    shape: [parts.length, ...shape], low: [0, ...low], steps: [1, ...steps] });
}

// grid: axes of the values, first the time where there is one, then the states of the indices `states`;
// times: those of the first axis, of which the nearest is taken. The function gives, for a state, a
// time and two indices of states, the value over these two: linear between nodes, NaN outside the grid.
function slices(values, { states, times, shape, low, steps, periodic }) {
  const timed = shape.length - states.length;
  const strides = shape.map((_, i) => shape.slice(i + 1).reduce((a, b) => a * b, 1));
  return (now, when, x, y) => {
    let corners = [[0, 1]];
    const spread = (i, p) => {
      corners = !p ? [] : corners.flatMap(([at, w]) => [[at + p.node * strides[i], w * (1 - p.part)], [at + p.next * strides[i], w * p.part]]).filter(([, w]) => w);
    };
    if (timed) spread(0, times?.length ? { node: storedTime(times, when), next: 0, part: 0 } : near(0, when));
    states.forEach((s, k) => { if (s !== x && s !== y) spread(k + timed, near(k + timed, now[s])); });
    const [a, b] = [x, y].map((s) => states.indexOf(s)), [i, j] = [a + timed, b + timed];
    const rows = a < 0 ? 1 : shape[i], columns = b < 0 ? 1 : shape[j], table = new Float64Array(rows * columns);
    for (let r = 0, k = 0; r < rows; r++) for (let c = 0; c < columns; c++, k++) {
      const from = (a < 0 ? 0 : r * strides[i]) + (b < 0 ? 0 : c * strides[j]);
      for (const [at, w] of corners) table[k] += w * values[from + at];
    }
    const along = (axis, of, value) => (axis < 0 ? { node: 0, next: 0, part: 0 } : near(of, value));
    const across = (value) => along(a, i, value), up = (value) => along(b, j, value);
    const of = (p, q) => {
      if (!p || !q || !corners.length) return NaN;
      const r = p.node * columns, next = p.next * columns, { node, next: after, part } = q;
      return (1 - p.part) * ((1 - part) * table[r + node] + part * table[r + after])
        + p.part * ((1 - part) * table[next + node] + part * table[next + after]);
    };
    return { across, up, of, at: (x, y) => of(across(x), up(y)) };
  };
  function near(i, value) {
    const count = shape[i];
    let q = (value - low[i]) / steps[i];
    if (periodic[i]) q -= count * Math.floor(q / count);
    else if (i < timed) q = Math.min(Math.max(q, 0), count - 1);
    else if (!(q >= -ROUNDED && q <= count - 1 + ROUNDED)) return null;
    else q = Math.min(Math.max(q, 0), count - 1);
    const node = Math.min(Math.floor(q), Math.max(count - (periodic[i] ? 1 : 2), 0));
    return { node, next: (node + 1) % count, part: q - node };
  }
}

// The number of the nearest time.
function storedTime(times, when) {
  return times.reduce((best, time, k) => (Math.abs(time - when) < Math.abs(times[best] - when) ? k : best), 0);
}
