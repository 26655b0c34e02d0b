"""SDKs that not every stage needs: installed as extras, loaded where a rig asks for them."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from stage.errors import DeviceError


def require(module: str, extra: str) -> ModuleType:
    """A vendor's module; raises `DeviceError` with the command that installs it where it is missing.

    Parameters
    ----------
    module : str
        As it is imported.
    extra : str
        Extra of this distribution that brings it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise DeviceError(
            f"{module}: the driver needs this package, which cannot be loaded ({error}); "
            f"install it: pip install 'lightstage[{extra}]'"
        ) from None
