"""Attacks on holdfast: random problems, oracles that share no code with it, faults as small files.

    python benchmarks/attack.py --minutes 30 --seed 1

Every kind of attack is a module with `KIND`, an `attacks.case.Kind`: a case is drawn from (seed,
number), tried, judged by what `holdfast` does not compute, and shrunk if it is a fault. Of
`holdfast` only public names are used. What is said of the kinds stands in docs/attacks.md.
"""
