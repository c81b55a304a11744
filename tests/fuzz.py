"""Coverage-guided fuzzing of what strangers write: expressions, conditions, scenario files.

    python -m pip install atheris
    python -m tests.fuzz expressions -max_total_time=600
    python -m tests.fuzz files -max_total_time=600

Whatever the input, the answer is an object or a `HoldfastError`, within the seconds of -timeout.
What was found is kept as a test in `test_hostile_input.py`. Not collected by pytest.
"""

import sys
import warnings

import atheris

with atheris.instrument_imports(include=["holdfast"]):
    import copy
    import tomllib

    import holdfast as hf
    from holdfast.errors import GainWarning, HoldfastError
    from holdfast.maths.expressions.parser import parse_condition, parse_expression
    from holdfast.scenario.files import read_text
    from holdfast.scenario.load import scenario_of
    from tests.hostile import KEYS, VALUES, WORDS, base, go_through, inside, paths

warnings.simplefilter("ignore", GainWarning)

NAMES = {n: hf.symbol(n) for n in ("x", "y", "psi", "k1", "t")}


def expressions(data):
    """Text made of words that mean something here, and of others."""
    provider = atheris.FuzzedDataProvider(data)
    condition = provider.ConsumeBool()
    parts = []
    while provider.remaining_bytes() and len(parts) < 200:
        place = provider.ConsumeIntInRange(0, len(WORDS) + 3)
        parts.append(WORDS[place] if place < len(WORDS) else provider.ConsumeUnicode(3))
    try:
        found = (parse_condition if condition else parse_expression)("".join(parts), NAMES)
    except HoldfastError:
        return
    assert found.free_symbols <= set(NAMES.values())


def files(data):
    """A scenario with keys and values changed, taken away, put elsewhere; or any text at all."""
    provider = atheris.FuzzedDataProvider(data)
    tables = base(provider.ConsumeIntInRange(0, 2))
    for _ in range(provider.ConsumeIntInRange(1, 4)):
        *way, last = provider.PickValueInList(list(paths(tables)))
        place = inside(tables, way)
        kind = provider.ConsumeIntInRange(0, 4)
        if kind == 0:
            del place[last]
        elif kind == 1 and isinstance(place, dict):
            place[provider.ConsumeUnicode(8)] = place.pop(last)
        elif kind == 2:
            place[last] = provider.ConsumeUnicode(12)
        elif kind == 3:
            place[last] = provider.ConsumeFloat()
        else:
            value = copy.deepcopy(provider.PickValueInList(VALUES))
            if isinstance(place, dict) and provider.ConsumeBool():
                place[provider.PickValueInList(KEYS)] = value
            else:
                place[last] = value
    try:
        go_through(tables)
    except HoldfastError:
        return


def texts(data):
    """Bytes as a file."""
    provider = atheris.FuzzedDataProvider(data)
    name = provider.PickValueInList(["inspection", "ch4-chained-3", "ch2-unicycle", "ch6-corridor"])
    text = read_text(name)[1]
    at, end = sorted(provider.ConsumeIntInRange(0, len(text)) for _ in range(2))
    text = text[:at] + provider.ConsumeUnicode(60) + text[min(end, at + 200) :]
    try:
        tables = tomllib.loads(text)
        scenario_of("fuzz.toml", text, tables)
    except (HoldfastError, tomllib.TOMLDecodeError):
        return


if __name__ == "__main__":
    TARGETS = {f.__name__: f for f in (expressions, files, texts)}
    target = TARGETS[sys.argv.pop(1)]
    atheris.Setup(sys.argv, target)
    atheris.Fuzz()
