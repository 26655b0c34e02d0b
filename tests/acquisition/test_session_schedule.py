"""What is next: nothing is forgotten and nothing is taken twice, whatever fails."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from acquisition.plan import Shot
from acquisition.session.schedule import Due, Schedule, place_of, setup_of


def shots(lit: int, *, dark: int = 0, every: int | None = None, background: bool = False, flat: int = 0) -> list[Shot]:
    """Exposures as a plan would list them."""
    made: list[Shot] = []

    def add(**what: object) -> None:
        made.append(Shot(len(made), 0.1, **what))  # type: ignore[arg-type]

    for _ in range(dark):
        add(kind="dark")
    for i in range(lit):
        add(kind="light", candidates=(i,))
    for _ in range(0 if every is None else math.ceil(lit / every) + 1):
        add(kind="reference", candidates=(0,))
    for i in range(lit if background else 0):
        add(kind="light", part="background", candidates=(i,))
    for _ in range(flat):
        add(kind="flat", part="flat", candidates=(0,))
    return made


def drained(schedule: Schedule) -> list[Shot]:
    taken = []
    while (due := schedule.next()) is not None:
        taken.append(due.shot)
    assert not schedule.has_more
    return taken


@given(
    st.integers(0, 12), st.integers(0, 3), st.none() | st.integers(1, 5), st.booleans(), st.integers(0, 2), st.randoms()
)
def test_every_shot_is_taken_once_with_as_few_changes_of_the_object_as_there_are(
    lit: int, dark: int, every: int | None, background: bool, flat: int, random: object
) -> None:
    plan = shots(lit, dark=dark, every=every, background=background, flat=flat)
    order = np.random.default_rng(lit).permutation(lit).tolist()
    taken = drained(Schedule(plan, {("object", (i,)): () for i in order}, every))
    assert sorted(shot.index for shot in taken) == [shot.index for shot in plan]
    setups = [setup_of(shot) for shot in taken]
    assert [s for i, s in enumerate(setups) if i == 0 or setups[i - 1] != s] == [
        s for s in ("flat", "object", "background") if s in setups
    ]
    lights = [shot for shot in taken if shot.kind == "light" and shot.part == "object"]
    assert [shot.candidates[0] for shot in lights] == order
    first_lit = next((i for i, shot in enumerate(taken) if shot.kind == "light"), len(taken))
    assert all(i < first_lit for i, shot in enumerate(taken) if shot.kind == "dark")


def test_references_are_spread_evenly_and_frame_the_others() -> None:
    taken = drained(Schedule(shots(7, dark=2, every=3), {}, 3))
    assert "".join({"dark": "d", "light": "l", "reference": "R"}[shot.kind] for shot in taken) == "ddRlllRlllRlR"


def test_a_failure_is_tried_next_then_at_the_end_and_then_given_up() -> None:
    schedule = Schedule(shots(3), {}, None)
    first = schedule.next()
    assert first is not None
    schedule.again(Due(first.shot, attempt=2))
    assert schedule.next() == Due(first.shot, attempt=2)
    schedule.put_off(Due(first.shot, attempt=2))
    assert schedule.skipped == (0,)
    others = [schedule.next(), schedule.next()]
    assert [due and due.shot.index for due in others] == [1, 2]
    last = schedule.next()
    assert last == Due(first.shot, attempt=1, rounds=1)
    schedule.put_off(last)
    assert schedule.next() is None
    assert not schedule.has_more
    assert [due.shot.index for due in schedule.given_up] == [0]
    assert schedule.skipped == (0,)


def test_a_bracket_stays_at_its_place() -> None:
    plan = [Shot(i, t, candidates=(c,)) for i, (c, t) in enumerate((c, t) for c in range(3) for t in (0.1, 0.2))]
    taken = drained(Schedule(plan, {("object", (c,)): () for c in (2, 0, 1)}, None))
    assert [place_of(shot)[1][0] for shot in taken] == [2, 2, 0, 0, 1, 1]
    assert [shot.exposure_s for shot in taken] == [0.1, 0.2] * 3


def test_what_fails_after_all_else_was_taken_is_still_tried_again() -> None:
    schedule = Schedule(shots(2), {}, None)
    *_, last = iter(schedule.next, None)
    schedule.put_off(last)
    assert schedule.has_more
    again = schedule.next()
    assert again is not None
    assert (again.shot, again.rounds) == (last.shot, 1)
    schedule.put_off(again)
    assert not schedule.has_more
    assert schedule.next() is None
