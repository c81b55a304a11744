// The closed loop of `simulate` as WebAssembly: the same text, compiled for a browser, so that a run
// has the same numbers to the last bit. A block of runs has an array w of numbers in rows, one lane
// for each run, and an array s of whole numbers; `spec` says where what is.
"use strict";

const PAGE = 65536, MANY = 128; // states that a table over the plane is computed for at once

function decoded(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function unpacked(text) {
  const stream = new Blob([decoded(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

class ClosedLoop {
  // spec: as `WebLoop.described` says it, with the module and its numbers compressed. The loop of
  // measurements that are exact and in time is the faster one.
  static async of(spec) {
    const [exact, noisy, numbers, whole, table] = await Promise.all(
      [spec.exact, spec.noisy, spec.numbers, spec.whole, spec.table].map((t) => (t ? unpacked(t) : null)));
    const made = async (code) => new ClosedLoop(spec, await WebAssembly.compile(code), numbers, whole, table);
    const loop = await made(exact);
    loop.measured = noisy ? await made(noisy) : loop;
    return loop;
  }

  // The loop for what is measured so.
  for(given) {
    const exact = !given.delay && !(given.noise && [...given.noise.uniform, ...given.noise.normal].some((v) => v > 0));
    return exact ? this : this.measured;
  }

  constructor(spec, module, numbers, whole, table) {
    this.spec = spec;
    this.lanes = spec.lanes;
    this.columns = BigInt(spec.lanes);
    this.numbers = new Float64Array(numbers.buffer);
    this.whole = new BigInt64Array(whole.slice().buffer);
    const log = spec.records * spec.record_rows * this.lanes;
    this.atTable = spec.stack; // constants of the module lie below, the stack grows down from here
    this.atW = this.atTable + 16 * Math.ceil((table ? table.length : 0) / 16);
    this.atS = this.atW + 8 * (this.numbers.length + log);
    this.atStop = this.atS + 8 * this.whole.length;
    this.atOut = this.atStop + 16;
    const over = this.atOut + 16 * this.lanes * (spec.scene + spec.varied.length + spec.states + 8);
    const size = over + 8 * MANY * (spec.scene + spec.rows.plant[1] + spec.states + 1);
    const memory = new WebAssembly.Memory({ initial: Math.ceil(size / PAGE) + 1 });
    const instance = new WebAssembly.Instance(module, { env: {
      __linear_memory: memory,
      __stack_pointer: new WebAssembly.Global({ value: "i32", mutable: true }, spec.stack),
      __indirect_function_table: new WebAssembly.Table({ initial: 0, element: "anyfunc" }),
    } });
    this.call = instance.exports;
    this.f = new Float64Array(memory.buffer);
    this.i = new BigInt64Array(memory.buffer);
    this.table = table ? new Uint8Array(memory.buffer, this.atTable, table.length) : null;
    if (table) this.table.set(table);
    for (const k of spec.tables) this.whole[k] = BigInt(this.atTable);
    this.whole[spec.entry_of_log_at] = BigInt(this.atW + 8 * spec.log);
    this.whole[spec.entry_of_rings_at] = BigInt(this.atW + 8 * spec.rings);
    this.w = this.atW / 8;
    this.s = this.atS / 8;
    this.out = this.atOut / 8;
    this.over = over / 8;
  }

  // The place of a row of a quantity in f.
  row(name, row = 0) { return this.w + this.spec.rows[name][0] + row * this.lanes; }
  has(name) { return name in this.spec.rows; }
  fill(name, value, row = 0) {
    const at = this.row(name, row);
    this.f.fill(value, at, at + this.lanes);
  }
  // The values of a quantity in one lane.
  set(name, values, lane) {
    for (let row = 0, at = this.row(name) + lane; row < values.length; row++, at += this.lanes) this.f[at] = values[row];
  }

  // Set what the law of each lane believes and what its plant is: parameters by their order, then
  // disturbances that are numbers, then the sample time. What [varied] makes of them follows.
  setParameters(ofLane, given) {
    for (let lane = 0; lane < this.lanes; lane++) {
      const { gains, plant } = ofLane(lane), more = [...given.disturbance, given.sampleTime];
      this.set("gains", [...gains, ...more], lane);
      this.set("plant", [...plant, ...more], lane);
    }
    const { varied, drawn, varied_known, parameters } = this.spec;
    if (!varied.length) return;
    const address = (name) => 8 * this.row(name);
    if (this.call.leaf_varied) {
      this.call.leaf_varied(0, 0, 0, address("gains"), this.atOut, this.columns, this.columns);
    }
    varied.forEach((name, k) => {
      const row = parameters.indexOf(name);
      for (let lane = 0; lane < this.lanes; lane++) {
        const value = k < drawn ? this.f[this.row("gains", row) + lane]
          : this.f[this.out + (k - drawn) * this.lanes + lane];
        this.f[this.row("plant", row) + lane] = value;
        if (k < varied_known) this.f[this.row("gains", row) + lane] = value;
      }
    });
  }

  // Runs from `starts`, an array of states; one result for each (see `result`).
  // given: { gains, plant, disturbance, noise: {uniform, normal}, delay (samples), seed (its digits),
  // first, sampleTime; only: the quantities whose records are asked for }. own: gains and plant of
  // each run, where they are not those.
  runs(starts, given, own) {
    const loop = this.for(given), found = [];
    for (let first = 0; first < starts.length; first += this.lanes) {
      const part = [first, first + this.lanes];
      found.push(...loop.block(starts.slice(...part), given, first, own && own.slice(...part)));
    }
    return found;
  }

  block(starts, given, first, own) {
    const { f, i, spec, lanes } = this, last = starts.length - 1, of = (lane) => Math.min(lane, last);
    f.set(this.numbers, this.w);
    i.set(this.whole, this.s);
    this.setParameters((lane) => (own ? own[of(lane)] : given), given);
    const n = spec.states;
    for (let lane = 0; lane < lanes; lane++) {
      this.set("q", starts[of(lane)], lane);
      f[this.row("run") + lane] = (given.first || 0) + first + of(lane);
      f[this.row("alive") + lane] = lane <= last ? 1 : 0;
    }
    for (let k = 0; k < n; k++) {
      this.fill("noise", given.noise ? given.noise.uniform[k] : 0, k);
      this.fill("noise", given.noise ? given.noise.normal[k] : 0, n + k);
    }
    const seed = BigInt(given.seed || 0);
    this.fill("seed_low", Number(seed & 0xffffffffn));
    this.fill("seed_high", Number(seed >> 32n));
    this.setDelay(given.delay || 0);
    const call = (name) => this.call[name](this.atW, this.atS, 0, this.atStop);
    call("holdfast_begin");
    i[this.s + spec.entry_of_records] = BigInt(spec.records - 1);
    call("holdfast_advance");
    call("holdfast_finish");
    call("holdfast_end");
    return starts.map((_, lane) => this.result(lane, given.only));
  }

  setDelay(samples) {
    const { f, i, spec, lanes } = this, late = this.s + spec.late;
    if (!(samples >= 0 && samples <= spec.latest)) throw new RangeError(`a delay of ${samples} samples`);
    const slots = samples + 1, size = spec.states * lanes;
    i[late] = 0n;
    i[late + 1] = BigInt(slots);
    this.fill("delay", slots - 1);
    const ring = this.w + spec.rings + Number(i[late + 2]) * lanes, q = this.row("q");
    for (let slot = 0; slot < slots; slot++) f.copyWithin(ring + slot * size, q, q + size);
  }

  // A run: arrays of its records, one after the other, and how it ended.
  result(lane, only) {
    const { f, i, spec, lanes } = this, size = spec.record_rows * lanes;
    const done = Math.min(spec.records, Number(i[this.s]) / size);
    const log = this.w + spec.log + lane;
    let count = 0;
    while (count < done && f[log + count * size] !== 0) count++;
    const found = { count };
    for (const [name, [first, rows]] of Object.entries(spec.record)) {
      if (name === "alive" || (only && !only.includes(name))) continue;
      const values = new Float64Array(count * rows);
      for (let r = 0, at = 0; r < count; r++) {
        const from = log + r * size + first * lanes;
        for (let k = 0; k < rows; k++) values[at++] = f[from + k * lanes];
      }
      found[name] = values;
    }
    const end = (name, row = 0) => (this.has(name) ? f[this.row(name, row) + lane] : NaN);
    found.outcome = end("outcome");
    found.ended = spec.outcomes[found.outcome];
    found.goalTime = end("inside_since");
    found.exitTime = end("exit_time");
    found.exitConstraint = end("exit_constraint");
    found.switches = end("switches");
    found.overruled = end("overrules");
    found.infeasible = end("infeasible");
    found.worst = Array.from({ length: this.has("worst") ? spec.rows.worst[1] : 0 }, (_, j) => end("worst", j));
    return found;
  }

  // Fill what follows from the parameters of the plant, without a run.
  prepare() { this.call.holdfast_first(this.atW, this.atS, 0, this.atStop); }

  // The numbers of the scene in a state at a time, with the parameters of the plant last set.
  scene(state, time) {
    if (!this.spec.scene) return new Float64Array(0);
    const { f, lanes } = this, q = this.out, t = q + this.spec.states * lanes, out = t + lanes;
    for (let k = 0; k < this.spec.states; k++) f.fill(state[k], q + k * lanes, q + (k + 1) * lanes);
    f.fill(time, t, t + lanes);
    this.call.leaf_scene(8 * t, 8 * q, 0, 8 * this.row("plant"), 8 * out, this.columns, this.columns);
    return Float64Array.from({ length: this.spec.scene }, (_, k) => f[out + k * lanes]);
  }

  // Some numbers of the scene over a table of two states, [which, values] each, at the others of a
  // state: for each of the places `at`, row after row of the second one.
  sceneOver(state, time, [i, xs], [j, ys], at) {
    const { f, spec } = this, many = MANY, q = this.over, t = q + spec.states * many, p = t + many;
    const [plant, parameters] = spec.rows.plant, out = p + parameters * many;
    const total = xs.length * ys.length, tables = at.map(() => new Float64Array(total));
    const fill = (row, value) => f.fill(value, row, row + many);
    for (let k = 0; k < spec.states; k++) fill(q + k * many, state[k]);
    fill(t, time);
    for (let k = 0; k < parameters; k++) fill(p + k * many, f[this.w + plant + k * this.lanes]);
    for (let k = 0; k < total; k += many) {
      const count = Math.min(many, total - k);
      for (let c = 0; c < count; c++) {
        f[q + i * many + c] = xs[(k + c) % xs.length];
        f[q + j * many + c] = ys[Math.floor((k + c) / xs.length)];
      }
      this.call.leaf_scene(8 * t, 8 * q, 0, 8 * p, 8 * out, BigInt(many), BigInt(many));
      at.forEach((row, m) => tables[m].set(f.subarray(out + row * many, out + row * many + count), k));
    }
    return tables;
  }
}
