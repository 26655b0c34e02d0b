"""When enough is known, said in a sentence."""

from __future__ import annotations

from dataclasses import dataclass

NEGLIGIBLE = 0.05
"""All lights that are left may together take at most this share off the error for the loop to end."""

UNSEEN = 0.025
"""... or as many grey levels, a tenth of what rounding to 8 bits costs: no picture would look any different."""

SURPRISED = 1.5
"""The latest photographs came out so many times worse than predicted: the prediction is then no reason to stop."""

BELIEF_COUNTS = 2.0
"""A correction by few photographs is itself uncertain; the uncorrected prediction counts like so many of them."""

LOOKED_BACK_AT = 4.0


@dataclass(frozen=True)
class Outlook:
    """Expected errors at a point of the loop.

    Attributes
    ----------
    now, floor : float
        Expected mean absolute error of held-out pictures by the belief, with what is captured and if all candidates
        were; 8-bit grey levels.
    surprise : float or None
        Error of the latest photographs' prediction over what was expected; None before there are any.
    captured, left : int
        Candidates.
    misfit : float or None
        Root mean square grey levels by which the model is off whatever its parameters are, where that is too much to
        choose lights by its covariance.
    """

    now: float
    floor: float
    surprise: float | None
    captured: int
    left: int
    misfit: float | None = None

    @property
    def ratio(self) -> float:
        """Surprise drawn towards 1, for it is the mean of a few photographs."""
        if self.surprise is None:
            return 1.0
        return (BELIEF_COUNTS + LOOKED_BACK_AT * self.surprise) / (BELIEF_COUNTS + LOOKED_BACK_AT)

    @property
    def predicted(self) -> float:
        """`now`, corrected."""
        return self.now * self.ratio

    @property
    def predicted_floor(self) -> float:
        """`floor`, corrected."""
        return self.floor * self.ratio

    @property
    def gain(self) -> float:
        """Share of the error that all candidates left would take off together."""
        return 1 - self.floor / self.now if self.now > 0 else 0.0


@dataclass(frozen=True)
class Verdict:
    """Whether to stop, and the sentence that says why."""

    stop: bool
    reason: str


def judge(outlook: Outlook, *, tolerance: float | None, most: int) -> Verdict:
    """Whether to go on.

    The order matters: a limit of the person's ends the loop whatever is predicted, a surprise forbids to end it by
    prediction.
    """
    o = outlook
    error = f"held-out pictures are expected to be off by {o.predicted:.2f} grey levels"
    if o.misfit is not None:
        error += f" (the model itself is off by {o.misfit:.1f} root mean square, so lights are spread evenly)"
    if not o.left:
        return Verdict(True, f"Every light is captured; {error}.")
    if o.captured >= most:
        return Verdict(True, f"{o.captured} lights are captured, as many as were allowed; {error}.")
    if o.surprise is None or o.surprise > SURPRISED:
        how = "there is nothing yet to check it by"
        if o.surprise is not None:
            how = f"the latest photographs were off {o.surprise:.1f} times as far as predicted"
        return Verdict(False, f"Going on after {o.captured} lights: {error}, but {how}.")
    if tolerance is not None and o.predicted <= tolerance:
        return Verdict(True, f"Enough after {o.captured} lights: {error}, within the wanted {tolerance:g}.")
    others = f"all {o.left} others together would take {100 * o.gain:.0f} % off that"
    reachable = tolerance is not None and o.predicted_floor <= tolerance
    little = o.floor * (1 + NEGLIGIBLE) >= o.now or o.predicted - o.predicted_floor <= UNSEEN
    if little and not reachable:
        missed = "" if tolerance is None else f"; the wanted {tolerance:g} cannot be reached with these lights"
        return Verdict(True, f"Nothing more to gain after {o.captured} lights: {error}, and {others}{missed}.")
    return Verdict(False, f"Going on after {o.captured} lights: {error}, and {others}.")
