"""Which lights a model is fitted to and which it is judged on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stage.errors import InputError

FORMS = "every:N, folds:K, random:SHARE:SEED or a list of image numbers such as 2,7,12"


@dataclass(frozen=True)
class Split:
    """One division of a dataset's frames.

    Attributes
    ----------
    train, test : tuple of int
        Frame numbers, from 0, ascending, without a common member; neither is empty.
    """

    train: tuple[int, ...]
    test: tuple[int, ...]


def hold_out(spec: str, count: int) -> list[Split]:
    """Read a hold-out rule.

    Parameters
    ----------
    spec : str
        ``every:N`` holds out every N-th frame from N // 2 (``every:5``: 2, 7, 12, ...). ``folds:K`` makes K splits;
        frame i is held out in split i % K. ``random:SHARE:SEED`` holds out round(SHARE * count) frames, at least one,
        drawn without replacement by numpy's ``default_rng(SEED)``. ``2,7,12`` holds out the frames it lists.
    count : int
        Frames in the dataset.

    Returns
    -------
    list of Split
        One split, or K of them.

    Raises
    ------
    InputError
        Where the rule cannot be read or leaves nothing to fit to or nothing to judge on.
    """
    kind, _, rest = spec.strip().partition(":")
    if kind == "every":
        step = _whole(spec, rest, least=2)
        return [_split(spec, range(step // 2, count, step), count)]
    if kind == "folds":
        folds = _whole(spec, rest, least=2)
        if folds > count:
            raise InputError(f"--holdout {spec}: {folds} folds need at least {folds} images, the set has {count}")
        return [_split(spec, range(fold, count, folds), count) for fold in range(folds)]
    if kind == "random":
        return [_split(spec, _drawn(spec, rest, count), count)]
    return [_split(spec, index_list(spec, count, field="--holdout", hint=f"expected {FORMS}"), count)]


def index_list(text: str, count: int, *, field: str, hint: str = "expected image numbers such as 0,5,7") -> list[int]:
    """Image numbers ``0,5,7`` as ascending ints.

    Raises `InputError` that names `field` where the text is no such list, a number repeats or lies outside 0..count-1.
    """
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{field}: {hint}, got {text!r}") from None
    for number in numbers:
        if not 0 <= number < count:
            raise InputError(f"{field}: image {number} is not in the set, which has images 0 to {count - 1}")
    if len(set(numbers)) < len(numbers):
        twice = next(n for n in numbers if numbers.count(n) > 1)
        raise InputError(f"{field}: image {twice} is listed more than once")
    return sorted(numbers)


def _split(spec: str, held_out: Iterable[int], count: int) -> Split:
    test = tuple(sorted(held_out))
    train = tuple(i for i in range(count) if i not in set(test))
    if not test:
        raise InputError(f"--holdout {spec}: holds out none of the set's {count} images")
    if not train:
        raise InputError(f"--holdout {spec}: holds out all of the set's {count} images and leaves none to fit to")
    return Split(train, test)


def _whole(spec: str, text: str, *, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise InputError(f"--holdout: expected {FORMS}, got {spec!r}") from None
    if value < least:
        raise InputError(f"--holdout {spec}: the number must be at least {least}")
    return value


def _drawn(spec: str, rest: str, count: int) -> list[int]:
    share_text, _, seed_text = rest.partition(":")
    try:
        share, seed = float(share_text), int(seed_text)
    except ValueError:
        raise InputError(f"--holdout: expected {FORMS}, got {spec!r}") from None
    if not 0 < share < 1:
        raise InputError(f"--holdout {spec}: the share must lie between 0 and 1")
    if seed < 0:
        raise InputError(f"--holdout {spec}: the seed must not be negative")
    number = max(1, round(share * count))
    return [int(i) for i in np.random.default_rng(seed).choice(count, number, replace=False)]
