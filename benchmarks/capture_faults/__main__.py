"""``python -m benchmarks.capture_faults``: see the package."""

from __future__ import annotations

import sys

from benchmarks.capture_faults import main

if __name__ == "__main__":
    sys.exit(main())
