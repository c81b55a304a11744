import casadi as ca
import numpy as np


def rate(q, w):
    return ca.vertcat(ca.cos(q[2]), ca.sin(q[2]), w)


def least_time(start, steps=60):
    problem = ca.Opti()
    seconds = problem.variable()
    q, w = problem.variable(3, steps + 1), problem.variable(steps)
    for k in range(steps):
        h = seconds / steps
        a = rate(q[:, k], w[k])
        b = rate(q[:, k] + h / 2 * a, w[k])
        c = rate(q[:, k] + h / 2 * b, w[k])
        d = rate(q[:, k] + h * c, w[k])
        problem.subject_to(
            q[:, k + 1] == q[:, k] + h / 6 * (a + 2 * b + 2 * c + d)
        )
    problem.subject_to(q[:, 0] == start)
    # the pillar
    problem.subject_to(ca.vec(ca.sum1(q[:2, :] ** 2)) >= 1)
    # the walls
    problem.subject_to(problem.bounded(-2.8, ca.vec(q[:2, :]), 2.8))
    problem.subject_to(ca.sumsqr(q[:2, -1] - ca.DM([2, 0])) <= 0.5**2)
    problem.subject_to(problem.bounded(-1, w, 1))
    # a guess: to the goal, past the left side of the pillar
    line = np.linspace(start, [2.0, 0.0, 0.0], steps + 1).T
    line[1] += 1.2
    problem.set_initial(q, line)
    problem.set_initial(seconds, 5)
    problem.minimize(seconds)
    quiet = {"print_time": False, "ipopt.print_level": 0}
    problem.solver("ipopt", quiet)
    try:
        return problem.solve().value(seconds)
    except RuntimeError:  # IPOPT has found no solution
        return np.nan


starts = [[-2.0, 0.4, 0.0], [-2.5, 0.6, 0.0], [-1.5, 0.0, 0.0]]
least = np.array([least_time(start) for start in starts])
print("least times:", least.round(3))
