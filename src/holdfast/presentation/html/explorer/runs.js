// What is changed in the page, and runs of the loop in workers.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const loopSource = document.getElementById("loop").textContent;
const byId = (id) => document.getElementById(id);
const n = data.states.length, home = data.plane, still = data.slices !== null; // still: a set without a law
let [planeX, planeY] = home;
const HANDLER = `
let loops = null;
onmessage = async ({ data: job }) => {
  try {
    if (job.specs) loops = await Promise.all(job.specs.map((s) => ClosedLoop.of(s)));
    else postMessage({ runs: loops[job.variant].runs(job.starts, job.given, job.own) });
    if (job.specs) postMessage({ ready: true });
  } catch (error) { postMessage({ error: error.message }); }
};`;

// -- what can be changed -----------------------------------------------------------------------

// Numbers by name; `truth` is what the vehicle is while the law believes `values`.
function initial() {
  const drawn = drawnNames().map((name, k) => [name, data.drawn[0][k]]);
  return {
    variant: 0, start: [...data.starts[0]], values: { ...allValues(), ...Object.fromEntries(drawn) },
    truth: { ...data.plant }, disturbance: [...data.disturbance], uniform: [...data.noise.uniform],
    normal: [...data.noise.normal], delay: data.settings.delay, seed: data.settings.seed, run: 0, offset: [0, 0], cell: -1, axes: [...home],
  };
}
function allValues() { return Object.assign({}, ...data.variants.map((v) => v.values)); }
function drawnNames() { return [...Object.keys(data.draws), ...data.cases]; }

let state = initial(), sweep = null; // the table of a sweep, where the page has one
const variant = () => data.variants[state.variant];

function given(more = {}) {
  const names = variant().loop.parameters, values = { ...state.values, ...more };
  return {
    gains: names.map((name) => values[name]), plant: names.map((name) => state.truth[name] ?? values[name]),
    disturbance: state.disturbance, noise: { uniform: state.uniform, normal: state.normal },
    delay: Math.round(state.delay / data.settings.sample_time), seed: state.seed, first: state.run,
    sampleTime: data.settings.sample_time,
  };
}

// -- workers -------------------------------------------------------------------------------------

class Pool {
  constructor(count) {
    const url = URL.createObjectURL(new Blob([loopSource, HANDLER], { type: "text/javascript" }));
    this.idle = [];
    this.waiting = [];
    for (let k = 0; k < count; k++) {
      const worker = new Worker(url);
      worker.onmessage = ({ data: answer }) => {
        if (worker.ends) { if (answer.error) worker.ends.failed(new Error(answer.error)); else worker.ends.done(answer); }
        else if (answer.error) say(`The loop failed: ${answer.error}`);
        worker.ends = null;
        this.idle.push(worker);
        this.next();
      };
      worker.onerror = (error) => { say(`The loop failed: ${error.message}`); };
      worker.postMessage({ specs: data.variants.map((v) => v.loop) });
    }
  }

  run(job) { return new Promise((done, failed) => { this.waiting.push({ job, done, failed }); this.next(); }); }
  drop() { this.waiting.length = 0; }
  next() {
    while (this.idle.length && this.waiting.length) {
      const worker = this.idle.pop(), { job, ...ends } = this.waiting.shift();
      worker.ends = ends;
      worker.postMessage(job);
    }
  }
}

const cores = Math.max(1, Math.min(4, navigator.hardwareConcurrency || 2));
const first = new Pool(1), many = new Pool(cores);
let running = false, stale = true, fanAsked = 0;

// The one run follows at once; what is asked while it runs is asked once more.
async function follow() {
  if (still) { stale = page.drawn = false; return; }
  if (running) { stale = true; return; }
  running = true;
  try {
    while (stale) {
      stale = false;
      const { runs } = await first.run({ variant: state.variant, starts: [state.start], given: given() });
      page.run = withModes(runs[0]);
      page.drawn = false;
      tell();
    }
  } catch (error) { say(`The loop failed: ${error.message}`); }
  running = false;
}

async function fan() {
  const own = ++fanAsked;
  page.fanNumber = own;
  many.drop();
  page.fan = [];
  page.fanIsNow = false;
  page.drawn = false;
  if (still || !byId("fan").checked) { tellFan(); return; }
  const { starts } = data, part = Math.ceil(starts.length / (4 * cores));
  const jobs = [];
  const began = performance.now();
  for (let a = 0; a < starts.length; a += part) {
    const some = starts.slice(a, a + part);
    const own_numbers = some.map((_, k) => drawnOf(a + k)), now = { ...given(), first: a, only: ["state"] };
    jobs.push(many.run({ variant: state.variant, starts: some, given: now, own: own_numbers[0] && own_numbers }).then(({ runs }) => {
      if (own !== fanAsked) return;
      runs.forEach((run) => page.fan.push(pathOf(run)));
      page.drawn = false;
    }));
  }
  try { await Promise.all(jobs); } catch (error) { notice(`Some runs failed: ${error.message}`); }
  if (own !== fanAsked) return;
  page.fanIsNow = true;
  page.fanSeconds = (performance.now() - began) / 1000;
  tellFan();
}

// What the scenario draws for a run of the fan.
function drawnOf(run) {
  const fixed = sweep ? sweep.fixed() : [], names = drawnNames();
  if (!names.length) return null;
  const drawn = names.map((name, k) => [name, data.drawn[run][k]]).filter(([name]) => !fixed.includes(name));
  const { gains, plant } = given(Object.fromEntries(drawn));
  return { gains, plant };
}

function withModes(run) {
  if (!(variant().modes.length > 1)) delete run.mode;
  return run;
}

function pathOf(run) {
  const xy = new Float64Array(2 * run.count);
  for (let k = 0; k < run.count; k++) {
    xy[2 * k] = run.state[k * n + planeX];
    xy[2 * k + 1] = run.state[k * n + planeY];
  }
  let left = null;
  if (run.ended === "LEFT" && run.count) {
    const k = Math.min(run.count - 1, Math.floor(run.exitTime / page.recordEvery));
    left = [xy[2 * k], xy[2 * k + 1]];
  }
  return { xy, outcome: run.outcome, left };
}
