"""The verbs of the command line as plain functions: ``from api import fit, relight, evaluate``.

Each is imported when it is first used, so that one verb does not load what another needs. ``import`` is a word of the
language; its function is ``import_``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from api.demonstration import demo
    from api.verbs.benchmarking import bench
    from api.verbs.calibrating_geometry import apply_lights, calibrate_camera, calibrate_chrome
    from api.verbs.calibrating_photometry import calibrate_dark, calibrate_flat, calibrate_response, calibrate_white
    from api.verbs.capturing import capture
    from api.verbs.checking import check_rig
    from api.verbs.checking_plan import check_plan
    from api.verbs.controlling import session
    from api.verbs.evaluating import evaluate
    from api.verbs.fitting import fit
    from api.verbs.importing import import_
    from api.verbs.planning import plan
    from api.verbs.relighting import relight
    from api.verbs.simulating import simulate

_VERBS = {
    "apply_lights": "api.verbs.calibrating_geometry",
    "bench": "api.verbs.benchmarking",
    "calibrate_camera": "api.verbs.calibrating_geometry",
    "calibrate_chrome": "api.verbs.calibrating_geometry",
    "calibrate_dark": "api.verbs.calibrating_photometry",
    "calibrate_flat": "api.verbs.calibrating_photometry",
    "calibrate_response": "api.verbs.calibrating_photometry",
    "calibrate_white": "api.verbs.calibrating_photometry",
    "capture": "api.verbs.capturing",
    "check_plan": "api.verbs.checking_plan",
    "check_rig": "api.verbs.checking",
    "demo": "api.demonstration",
    "evaluate": "api.verbs.evaluating",
    "fit": "api.verbs.fitting",
    "import_": "api.verbs.importing",
    "plan": "api.verbs.planning",
    "relight": "api.verbs.relighting",
    "session": "api.verbs.controlling",
    "simulate": "api.verbs.simulating",
}

__all__ = [
    "apply_lights",
    "bench",
    "calibrate_camera",
    "calibrate_chrome",
    "calibrate_dark",
    "calibrate_flat",
    "calibrate_response",
    "calibrate_white",
    "capture",
    "check_plan",
    "check_rig",
    "demo",
    "evaluate",
    "fit",
    "import_",
    "plan",
    "relight",
    "session",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _VERBS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_VERBS[name]), name)
