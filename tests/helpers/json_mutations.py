"""Random changes of JSON values, as a fuzzer makes them."""

import random
from typing import Any

NUMBERS = [0, 1, -1, 0.5, -0.5, 1e-9, 90, 1000, 1e9, -1e10, 1e300, 2**31, 2**40, 2**63, 2**64]
VALUES = [
    *(None, True, False, 0, -1, 1, 1.5, 1.0, 16.0, 10**18, 10**30, -(2**64), 1e300, -0.0),
    *("", "x", "\x1b[2J", "\ud800", "a:b", [], {}, [1, 2], [[1]], {"a": 1}),
]


def mutate(rng: random.Random, value: Any, depth: int = 0) -> Any:
    """Change one random part of a JSON value, in place where that is possible."""
    if isinstance(value, dict) and value and (depth < 2 or rng.random() < 0.9):
        key = rng.choice(sorted(value))
        kind = rng.random()
        if kind < 0.05:
            del value[key]
        elif kind < 0.1:
            value[rng.choice(["new", "distortion", "token", "scene", "maps", "attribute"])] = rng.choice(VALUES)
        else:
            value[key] = mutate(rng, value[key], depth + 1)
        return value
    if isinstance(value, list) and value and (depth < 2 or rng.random() < 0.9):
        index = rng.randrange(len(value))
        if rng.random() < 0.1:
            value.append(value[index]) if rng.random() < 0.5 else value.pop(index)
        else:
            value[index] = mutate(rng, value[index], depth + 1)
        return value
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return rng.choice(NUMBERS if is_number and rng.random() < 0.7 else VALUES)
