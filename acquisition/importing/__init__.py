"""Foreign folders of photographs: read in place (`load_any`) or copied into a dataset folder (`import_dataset`)."""

from __future__ import annotations

from acquisition.importing.layouts import FORMATS, import_dataset, load_any

__all__ = ["FORMATS", "import_dataset", "load_any"]
