"""What a person reads of a plan on the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stage.planning.outcome import ASKED

OF_ALL = "_of_all_candidates"
FIGURES = {
    "share": "shown of what can be",
    "share_bound": "no such choice shows more than",
    "relative_error": "expected error of relighting",
    "wanted": "lights it is judged by",
    "points": "points judged",
    "relative_std_diffuse": "expected error, diffuse",
    "relative_std_specular": "expected error, specular",
    "relative_std_roughness": "expected error, roughness",
    "share_roughness_known": "pixels of known roughness",
    "predicted_error": "expected error, grey levels",
    "floor_error": "with all candidates, grey levels",
    "surprise": "found error over expected",
}
"""Names of `stage.planning.LightPlan.figures`, and of those of a closed loop, in words."""

SHARES = ("share", "share_bound", "share_roughness_known", "relative_error")


def for_people(plan: Mapping[str, Any], *, asked: bool = False) -> dict[str, Any]:
    """What a person wants to read of what ``plan`` found, by label; the rest is in its file.

    Parameters
    ----------
    plan : mapping
        As `api.plan` returns it.
    asked : bool
        Not the target but a number of lights, or the published rule, ended the choice: its bound then is of what the
        lights show.
    """
    facts: dict[str, Any] = {
        "plan": plan["out"],
        "method": plan["method"],
        "lights": f"{plan['count']}{_proof(plan, asked)}",
        "which": ", ".join(map(str, plan["lights"])),
    }
    for part in ("diffuse", "specular"):
        if (share := plan["coverage"][part]) is not None:
            facts[part] = f"{_percent(share)} of the object, of {_percent(plan['coverage'][f'limit_{part}'])} possible"
    if "seconds" in plan:
        facts["seconds"] = f"{plan['seconds']:.1f}; to reach the target takes at least {plan['seconds_bound']:.1f}"
    if plan["figures"]:
        facts["figures"] = _figures(plan["figures"])
    if plan["warnings"]:
        facts["warnings"] = plan["warnings"]
    if "decisions" in plan:
        facts["decisions"] = [step["reason"] for step in plan["decisions"]]
    if "report" in plan:
        facts["report"] = plan["report"]
    return facts


def _proof(plan: Mapping[str, Any], asked: bool) -> str:
    if "decisions" in plan:
        return ", chosen by what their pictures taught"
    if plan["bound_by"] == ASKED:
        return ", as asked for"
    if plan["gap"] == 0:
        return f"; no fewer {'show as much' if asked else 'reach the target'} ({plan['bound_by']})"
    much = "to show as much" if asked else "the target"
    return f"; {much} takes at least {plan['lower_bound']} ({plan['bound_by']})"


def _figures(figures: Mapping[str, float]) -> dict[str, str]:
    """Figures by what they are called in words, beside those of all candidates."""
    told = {}
    for name, value in figures.items():
        if name.endswith(OF_ALL):
            continue
        told[FIGURES.get(name, name.replace("_", " "))] = _figure(name, value)
        if (everything := figures.get(name + OF_ALL)) is not None:
            told[FIGURES.get(name, name.replace("_", " "))] += f"; by all candidates {_figure(name, everything)}"
    return told


def _figure(name: str, value: float) -> str:
    return _percent(value) if name in SHARES or name.startswith("relative_std") else f"{value:.4g}"


def _percent(share: float) -> str:
    """Never rounded up to all, nor down to nothing."""
    text = f"{100 * share:.1f}"
    if share < 1 and text == "100.0":
        return "99.9 %"
    return "less than 0.1 %" if share > 0 and text == "0.0" else f"{text} %"
