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
    from api.verbs.capturing import capture
    from api.verbs.evaluating import evaluate
    from api.verbs.fitting import fit
    from api.verbs.importing import import_
    from api.verbs.planning import plan
    from api.verbs.relighting import relight

_VERBS = {
    "bench": "api.verbs.benchmarking",
    "capture": "api.verbs.capturing",
    "demo": "api.demonstration",
    "evaluate": "api.verbs.evaluating",
    "fit": "api.verbs.fitting",
    "import_": "api.verbs.importing",
    "plan": "api.verbs.planning",
    "relight": "api.verbs.relighting",
}

__all__ = ["bench", "capture", "demo", "evaluate", "fit", "import_", "plan", "relight"]


def __getattr__(name: str) -> Any:
    if name not in _VERBS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_VERBS[name]), name)
