from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruct.holdout import hold_out, index_list
from stage.errors import InputError


def test_every_fifth_from_the_third():
    [split] = hold_out("every:5", 13)
    assert split.test == (2, 7, 12)
    assert split.train == (0, 1, 3, 4, 5, 6, 8, 9, 10, 11)


@pytest.mark.parametrize(
    ("spec", "test"), [("every:2", (1, 3, 5)), ("every:3", (1, 4)), ("every:4", (2,)), ("every:10", (5,))]
)
def test_every_begins_at_half_the_step(spec, test):
    assert hold_out(spec, 6)[0].test == test


def test_folds_rotate_through_all():
    splits = hold_out("folds:3", 7)
    assert [s.test for s in splits] == [(0, 3, 6), (1, 4), (2, 5)]
    assert splits[1].train == (0, 2, 3, 5, 6)


def test_a_list_is_taken_as_it_is():
    [split] = hold_out("4, 0,2", 5)
    assert split == type(split)(train=(1, 3), test=(0, 2, 4))


def test_random_is_the_seed_and_the_share():
    first, again, other = (hold_out(spec, 40)[0].test for spec in ("random:0.2:7", "random:0.2:7", "random:0.2:8"))
    assert len(first) == 8
    assert first == again != other
    assert len(hold_out("random:0.001:0", 10)[0].test) == 1


SPECS = st.one_of(
    st.integers(2, 9).map(lambda n: f"every:{n}"),
    st.integers(2, 9).map(lambda n: f"folds:{n}"),
    st.tuples(st.floats(0.05, 0.9), st.integers(0, 99)).map(lambda t: f"random:{t[0]}:{t[1]}"),
    st.sets(st.integers(0, 9), min_size=1, max_size=9).map(lambda s: ",".join(map(str, s))),
)


@given(SPECS, st.integers(10, 60))
def test_every_rule_divides_the_frames(spec, count):
    splits = hold_out(spec, count)
    for split in splits:
        assert split.train
        assert split.test
        assert sorted(split.train + split.test) == list(range(count))
    if spec.startswith("folds"):
        assert sorted(i for split in splits for i in split.test) == list(range(count))


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("", "expected every:N"),
        ("every", "expected every:N"),
        ("every:x", "expected every:N"),
        ("every:1", "at least 2"),
        ("every:0", "at least 2"),
        ("every:30", "holds out none"),
        ("folds:1", "at least 2"),
        ("folds:11", "need at least 11 images"),
        ("random:0.2", "expected every:N"),
        ("random:0:1", "between 0 and 1"),
        ("random:nan:1", "between 0 and 1"),
        ("random:0.99:1", "holds out all"),
        ("random:0.2:-1", "seed"),
        ("1,2,x", "expected every:N"),
        ("1,2,10", "image 10 is not in the set"),
        ("-1", "image -1 is not in the set"),
        ("1,2,1", "more than once"),
        ("0,1,2,3,4,5,6,7,8,9", "leaves none"),
    ],
)
def test_a_rule_that_cannot_be_met_is_refused(spec, says):
    with pytest.raises(InputError, match=f"--holdout.*{says}"):
        hold_out(spec, 10)


def test_index_list_names_its_option():
    assert index_list("5,0", 6, field="--lights") == [0, 5]
    with pytest.raises(InputError, match="--lights: expected image numbers such as 0,5,7, got 'a'"):
        index_list("a", 6, field="--lights")
