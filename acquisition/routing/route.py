"""A way through the lights of a plan, as a value that can be kept beside it."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from itertools import pairwise
from typing import Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from acquisition.plan import PlanPart
from stage.errors import InputError
from stage.rig import Rig
from stage.rig.parts import NonNegative
from stage.validation import first_fault

SCHEMA = "lightstage-route/1"


class Route(PlanPart):
    """Positions in the order in which the light visits them, and the joint values that it visits them with.

    Attributes
    ----------
    order : tuple of int
        Each position once, by its number in the list that was ordered.
    joints : tuple of tuples of float
        For each step of the order, radians or metres.
    start : tuple of float or None
        Where the joints stood; None where the route begins at its first light.
    travel_s : float
        Seconds of all moves.
    settle_s : float
        Seconds of rest after them, one rest per light.
    lower_bound_s : float or None
        No order has moves that take fewer seconds in all; None where that is not known.
    bound_over : "all joint values" or "joint values found"
        What the bound holds for: an arm with more joints than a place has coordinates reaches it in infinitely many
        ways, of which only some were looked at.
    """

    schema_name: Literal["lightstage-route/1"] = Field(alias="schema", default="lightstage-route/1")
    order: tuple[int, ...]
    joints: tuple[tuple[float, ...], ...]
    start: tuple[float, ...] | None = None
    travel_s: NonNegative
    settle_s: NonNegative
    lower_bound_s: NonNegative | None = None
    bound_over: Literal["all joint values", "joint values found"] = "all joint values"

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if len(self.joints) != len(self.order):
            raise ValueError(
                f"joints: expected {len(self.order)} rows, one per step of the order, got {len(self.joints)}"
            )
        if len(set(self.order)) < len(self.order) or min(self.order, default=0) < 0:
            raise ValueError("order: expected each position once, by its number from 0")
        return self

    @property
    def gap(self) -> float | None:
        """Share by which travel exceeds its lower bound; None where there is no bound, or a bound of zero only.

        Rests are left out: every order has as many.
        """
        if self.lower_bound_s is None:
            return None
        if self.lower_bound_s == 0:
            return 0.0 if self.travel_s == 0 else None
        return max(self.travel_s / self.lower_bound_s - 1, 0.0)

    def without(self, done: Collection[int], rig: Rig, start: Sequence[float] | None = None) -> Route:
        """The rest of the route in the same order, straight on over what is left out.

        Parameters
        ----------
        done : collection of int
            Positions that need not be visited any more; others than those of the order do not matter.
        rig : Rig
            That of the route.
        start : (k,) float, optional
            Where the joints stand now.

        Returns
        -------
        Route
            Without a lower bound: that of all positions says nothing of some.

        Raises
        ------
        InputError
            Where a keep-out zone is in the way of a move that was not part of the route; order anew then.
        """
        left_out = frozenset(done)
        steps = [step for step, position in enumerate(self.order) if position not in left_out]
        stops: list[tuple[float, ...]] = [] if start is None else [tuple(float(value) for value in start)]
        stops += [self.joints[step] for step in steps]
        moves = list(pairwise(stops)) if steps else []
        if rig.keep_out:
            self._require_clear(rig, moves, steps)
        return Route(
            order=tuple(self.order[step] for step in steps),
            joints=tuple(self.joints[step] for step in steps),
            start=None if start is None else stops[0],
            travel_s=sum(rig.motion.travel_s(here, there) for here, there in moves),
            settle_s=rig.motion.settle_s * len(steps),
            bound_over=self.bound_over,
        )

    def _require_clear(
        self, rig: Rig, moves: Sequence[tuple[tuple[float, ...], tuple[float, ...]]], steps: Sequence[int]
    ) -> None:
        """Refuse moves to some steps, the last of all moves to the last of them, that were no part of the route."""
        driven = set(pairwise(((self.start,) if self.start else ()) + self.joints))
        for number, (here, there) in enumerate(moves):
            if (here, there) not in driven and (reason := rig.moving_obstruction(here, there)) is not None:
                ahead = len(steps) - len(moves) + number
                origin = f"position {self.order[steps[ahead - 1]]}" if ahead else "where the joints stand"
                raise InputError(
                    f"route: order: from {origin} straight on to position {self.order[steps[ahead]]}, {reason}"
                )

    def to_json(self) -> dict[str, Any]:
        """The route as its file writes it."""
        return self.model_dump(mode="json", by_alias=True)

    @classmethod
    def from_json(cls, data: object, source: str = "route") -> Route:
        """Check a route that was read from a file; raises `InputError` that names `source` and the field."""
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise InputError(f"{source}: schema: expected {SCHEMA!r}")
        try:
            return cls.model_validate_json(json.dumps(data))
        except ValidationError as error:
            raise InputError(f"{source}: {first_fault(error)}") from None
