"""What is wrong with data from a file, in the words of the person who wrote the file."""

from __future__ import annotations

import re
from collections.abc import Collection

from pydantic import ValidationError
from pydantic_core import ErrorDetails

_LONGEST = 60
_NAMES_A_FIELD = re.compile(r"[a-z_]\w*(\.\w+|\[\d+\])*: ")


def first_fault(error: ValidationError, tags: Collection[str] = ()) -> str:
    """Field and fault of the first problem that pydantic found, such as ``frames[2].light: is required and missing``.

    A validator of ours that raises ``ValueError("field: fault")`` has its field put behind the place it ran at. `tags`
    are names of alternatives, which pydantic puts among the fields.
    """
    problem = error.errors(include_url=False)[0]
    field = ""
    for part in problem["loc"]:
        if part in tags:
            continue
        field += f"[{part}]" if isinstance(part, int) else f".{part}" if field else str(part)
    match problem["type"]:
        case "extra_forbidden":
            return f"{field}: unknown key"
        case "missing":
            return f"{field}: is required and missing"
        case "union_tag_not_found":
            return f"{field}.{_discriminator(problem)}: is required and missing"
        case "union_tag_invalid":
            expected = str(problem["ctx"]["expected_tags"]).replace("'", "")
            got = shortened(problem["ctx"]["tag"])
            return f"{field}.{_discriminator(problem)}: expected one of {expected}, got {got}"
        case "finite_number":
            return f"{field}: NaN and infinity are not allowed"
        case "value_error":
            fault = str(problem["ctx"]["error"])
            if not field or fault.startswith(f"{field}."):
                return fault
            return f"{field}.{fault}" if _NAMES_A_FIELD.match(fault) else f"{field}: {fault}"
        case _:
            return f"{field}: {problem['msg'][:1].lower()}{problem['msg'][1:]}, got {shortened(problem['input'])}"


def _discriminator(problem: ErrorDetails) -> str:
    return str(problem["ctx"]["discriminator"]).strip("'")


def shortened(value: object) -> str:
    """A value as Python writes it, cut where a sentence would become hard to read."""
    text = repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
