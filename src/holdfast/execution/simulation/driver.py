"""The simulation loop, written for Numba.

`compile.py` joins this file below the mark and the text of one closed loop, which
`closed_loop_source.py` makes: the functions here that only raise are the interface, and the
generated ones take their place.
State, inputs and rates are tuples; `plant` holds the parameters of the simulated vehicle and
`gains` those its controller believes, in the same order.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.trajectory import *  # noqa: F403

# -- joined from here on

DIVERGED_AT = 1e9
ONE_SECOND = 1.0 - 1e-9
MOST_STEPS = 1_000_000  # adaptive steps within one control sample


# -- the interface: replaced by the generated constants and functions -------------------

WATCHED, SIGNALS, ACTUATORS = 0, 0, 0  # how many; Numba leaves out what a constant rules out
SAFEGUARDED = False
CONTINUOUS, ADAPTIVE, ORDER = False, False, 1
LOOKED_UP, FIRST_STATE = 0, 0  # axes of the table of the law; the first of them that is a state


def rates(t, q, u, d, p):
    """f(t, q, u, d; p)."""
    raise NotImplementedError


def disturbance(t, p):
    """d(t; p)."""
    raise NotImplementedError


def allocate(u, p):
    """The actuator values that produce u, as the controller believes."""
    raise NotImplementedError


def limit(a, p):
    """The admissible actuator values taken in place of a."""
    raise NotImplementedError


def produce(a, p):
    """The input that the actuators bring about."""
    raise NotImplementedError


def law(t, q, mode, p, table):
    """The commanded input in a mode, and the slack that its safeguard needed.

    Where SAFEGUARDED, whether the safeguard overruled the law, and what the law had asked for.
    """
    raise NotImplementedError


def nominal(answer):
    """The nominal command, taken from the values that `law` returned."""
    raise NotImplementedError


def next_mode(t, q, mode, time_in_mode, p):
    """The mode after the guards are tried."""
    raise NotImplementedError


def places(t, q, p):
    """The lookup table of the function that the law uses."""
    raise NotImplementedError


def signals(t, q, p, table):
    """The named expressions worth recording."""
    raise NotImplementedError


def constraints(q, p):
    """c_j(q); safe where <= 0."""
    raise NotImplementedError


def constraint_rates(q, qdot, p):
    """grad c_j . qdot."""
    raise NotImplementedError


def goal_level(q, p):
    """<= 0 in the goal."""
    raise NotImplementedError


def varied(p):
    """The values that follow from what was drawn for a run."""
    raise NotImplementedError


def felt(t, p):
    """The disturbances that the law measures, as they are."""
    raise NotImplementedError


def first_memory(q, p):
    """The initial memory of the controller."""
    raise NotImplementedError


def next_memory(t, q, u, p, sample_time):
    """The memory at the next sample."""
    raise NotImplementedError


def as_tuple(values):
    """The first entries of an array as the state tuple."""
    raise NotImplementedError


def as_memory(values):
    """The entries of an array as the tuple of what is remembered."""
    raise NotImplementedError


def step(t, h, q, k0, u, mode, plant, gains, table):
    """One Runge-Kutta step: the new state and the error estimate."""
    raise NotImplementedError


# -- the closed loop --------------------------------------------------------------------


@inlined
def field(t, q, u, mode, plant, gains, table):
    """qdot; with continuous control the input is the law's at this very state."""
    if CONTINUOUS:
        seen = q + felt(t, plant)
        seen = seen + first_memory(seen, gains)  # of the right length: nothing is remembered
        u = produce(limit(allocate(law(t, seen, mode, gains, table), gains), plant), plant)
    return rates(t, q, u, disturbance(t, plant), plant)


@compiled
def simulate_runs(first, last, before, starts, numbers, sampling, out, stop, progress):
    """Simulate the runs first..last-1; every array of `out` is indexed by run.

    numbers, sampling, out: the named tuples of `loop_arguments`. The runs are `before` + first and
    so on of those that share the seed: a run draws its random numbers by that place.

    The first time at which c_j exceeds the tolerance is located inside the step in which it
    happens. The arrays of the safeguard are empty where there is none.
    `stop[0]` set from outside ends the call early; `progress[0]` counts control samples.
    """
    sample_time, samples, delay = sampling.sample_time, sampling.samples, sampling.delay
    n = starts.shape[1]
    m = out.input.shape[2]
    scratch = np.empty(n)
    past = np.empty((delay + 1, n))  # the states of the last samples, in turn
    plant, gains, table = numbers.plant.copy(), numbers.gains.copy(), numbers.table
    recent = np.empty(sampling.switch_limit)  # when the mode last changed, in turn
    for run in range(first, last):
        for j in range(len(numbers.varied_plant)):
            plant[numbers.varied_plant[j]] = numbers.own_plant[run, j]
        for j in range(len(numbers.varied_gains)):
            gains[numbers.varied_gains[j]] = numbers.own_gains[run, j]
        recent[:] = -np.inf
        q = as_tuple(starts[run])
        mode = sampling.initial_mode
        mode_since = 0.0
        inside_since = np.nan
        out.outcome[run] = STAYED
        trial = sample_time
        if WATCHED:
            c0 = constraints(q, plant)
            for j in range(WATCHED):
                out.worst[run, j] = c0[j]
                if c0[j] > sampling.tolerance and out.outcome[run] != LEFT:
                    out.outcome[run] = LEFT
                    out.exit_time[run] = 0.0
                    out.exit_constraint[run] = j
        for k in range(samples + 1):
            if stop[0] != 0:
                return
            t = k * sample_time
            back = k - min(delay, k)
            for i in range(n):
                past[k % (delay + 1), i] = q[i]
            for i in range(n):
                scratch[i] = past[back % (delay + 1), i]
            if sampling.noisy:
                add_noise(sampling.noise, sampling.seed, before + run, back, scratch)
            seen = as_tuple(scratch) + felt(back * sample_time, plant)
            if k == 0:
                memory = first_memory(seen, gains)
            seen = seen + memory
            last_mode = mode
            mode = next_mode(t, seen, mode, t - mode_since, gains)
            if mode != last_mode:
                if out.switches[run] > 0:
                    out.shortest_dwell[run] = min(out.shortest_dwell[run], t - mode_since)
                place = out.switches[run] % sampling.switch_limit
                if t - recent[place] < ONE_SECOND and out.outcome[run] == STAYED:
                    out.outcome[run] = CHATTERED
                    out.exit_time[run] = t
                recent[place] = t
                out.switches[run] += 1
                mode_since = t
            if LOOKED_UP:
                outside = beyond_grid(table, places(t, seen, gains), FIRST_STATE)
                if outside and math.isnan(out.off_grid[run]):
                    out.off_grid[run] = t
                    if out.outcome[run] == STAYED:
                        out.outcome[run] = OFF_GRID
                        out.exit_time[run] = t
            command = law(t, seen, mode, gains, table)
            if SAFEGUARDED:
                if command[m + 1] > 0.0:
                    out.overruled[run] += 1
                if command[m] > 0.0:
                    out.infeasible[run] += 1
                    out.largest_slack[run] = max(out.largest_slack[run], command[m])
            asked = allocate(command, gains)
            memory = next_memory(t, seen, produce(limit(asked, gains), gains), gains, sample_time)
            a = limit(asked, plant)
            u = produce(a, plant)
            if not below(u, np.inf) or not below(a, np.inf):
                end_of(run, t, out.outcome, out.exit_time)
                progress[0] += samples + 1 - k
                break
            for i in range(m):
                out.peak_input[run, i] = max(out.peak_input[run, i], abs(u[i]))
            if ACTUATORS:
                for i in range(ACTUATORS):
                    out.peak_actuator[run, i] = max(out.peak_actuator[run, i], abs(a[i]))
            if goal_level(q, plant) <= 0.0:
                if math.isnan(inside_since):
                    inside_since = t
            else:
                inside_since = np.nan
            if k % sampling.stride == 0:
                row = k // sampling.stride
                for i in range(n):
                    out.state[run, row, i] = q[i]
                for i in range(m):
                    out.input[run, row, i] = u[i]
                if ACTUATORS:
                    for i in range(ACTUATORS):
                        out.actuator[run, row, i] = a[i]
                out.mode[run, row] = mode
                if SAFEGUARDED:
                    wanted = nominal(command)
                    out.sample_slack[run, row] = command[m]
                    out.safeguard[run, row] = 2 if command[m] > 0.0 else int(command[m + 1])
                    for i in range(m):
                        out.nominal[run, row, i] = wanted[i]
                    if ACTUATORS:
                        wanted_actuators = allocate(wanted, gains)
                        for i in range(ACTUATORS):
                            out.nominal_actuator[run, row, i] = wanted_actuators[i]
                if SIGNALS:
                    s = signals(t, seen, gains, table)
                    for i in range(SIGNALS):
                        out.signal[run, row, i] = s[i]
                if WATCHED:
                    for j in range(WATCHED):
                        out.constraint[run, row, j] = c0[j]
            progress[0] += 1
            if k == samples:
                break
            # one sample interval
            k0 = field(t, q, u, mode, plant, gains, table)
            if WATCHED:
                d0 = constraint_rates(q, k0, plant)
            elapsed = 0.0
            index = 0
            stiff_at = out.rejected[run] + 4096
            failed = False
            while True:
                if ADAPTIVE:
                    if index + out.rejected[run] > stiff_at:  # also where an interruption is heard
                        failed = stop[0] != 0 or index > MOST_STEPS
                        if failed:
                            break
                        stiff_at += 4096
                    left = sample_time - elapsed
                    h = min(trial, left)
                    last_step = h >= left * (1.0 - 1e-12)
                else:
                    h = sample_time / sampling.substeps
                    last_step = index == sampling.substeps - 1
                new, error = step(t + elapsed, h, q, k0, u, mode, plant, gains, table)
                if ADAPTIVE:
                    size = error_size(q, new, error, sampling.absolute, sampling.relative)
                    if not size <= 1.0:
                        out.rejected[run] += 1
                        factor = (
                            0.2
                            if not math.isfinite(size)
                            else max(0.2, 0.9 * size ** (-1.0 / ORDER))
                        )
                        trial = h * factor
                        if trial < 1e-12 * sample_time:
                            failed = True
                            break
                        continue
                    grown = h * min(5.0, 0.9 * max(size, 1e-10) ** (-1.0 / ORDER))
                    if h >= trial or grown > trial:
                        trial = grown
                if not below(new, DIVERGED_AT):
                    failed = True
                    break
                if WATCHED or not last_step:
                    k1 = field(t + elapsed + h, new, u, mode, plant, gains, table)
                else:
                    k1 = k0
                if WATCHED:
                    c1 = constraints(new, plant)
                    if not below(c1, np.inf):
                        failed = True
                        break
                    d1 = constraint_rates(new, k1, plant)
                    earliest = 2.0
                    culprit = -1
                    for j in range(WATCHED):
                        top = c1[j]
                        at = 1.0
                        if (
                            d0[j] > 0.0
                            and d1[j] < 0.0
                            and tangent_bound(h, c0[j], d0[j], c1[j], d1[j]) > out.worst[run, j]
                        ):
                            s_peak = peak_fraction(j, h, q, k0, new, k1, plant, scratch)
                            inner = constraint_at(s_peak, j, h, q, k0, new, k1, plant, scratch)
                            if inner > top:
                                top = inner
                                at = s_peak
                        out.worst[run, j] = max(out.worst[run, j], top)
                        if top > sampling.tolerance and out.outcome[run] != LEFT:
                            fraction = crossing_fraction(
                                j, sampling.tolerance, at, h, q, k0, new, k1, plant, scratch
                            )
                            if fraction < earliest:
                                earliest = fraction
                                culprit = j
                    if culprit >= 0:
                        out.outcome[run] = LEFT
                        out.exit_time[run] = t + elapsed + earliest * h
                        out.exit_constraint[run] = culprit
                    c0 = c1
                    d0 = d1
                q = new
                k0 = k1
                elapsed += h
                index += 1
                if last_step:
                    break
            if failed:
                end_of(run, t + elapsed, out.outcome, out.exit_time)
                progress[0] += samples - k
                break
        out.goal_time[run] = inside_since
        if out.outcome[run] == STAYED and not math.isnan(inside_since):
            out.outcome[run] = REACHED
        if out.outcome[run] == DIVERGED:
            out.goal_time[run] = np.nan
