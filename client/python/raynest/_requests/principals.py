"""Lists of principals as text, as `raynest load --share` takes them."""
from __future__ import annotations

import re

from ..errors import UsageError

_VALUE = r'(?![ ])(?:[^,+"\\<>;\x00-\x1f\x7f]|\\[,+"\\<>;# =]|\\[0-9A-Fa-f]{2})*(?<!(?<!\\) )'
_PART = rf"(?:[A-Za-z][A-Za-z0-9-]*|[0-9][0-9.]*)={_VALUE}"
# A certificate's subject in the form of RFC 2253, as the daemon names principals.
_SUBJECT = re.compile(rf"{_PART}(?:[,+]{_PART})*")


def split_principals(text: str) -> list[str]:
    """Splits a list at its commas; "\\," is a comma in a name, "\\\\" a backslash. Refuses what may be
    one certificate's subject whose commas were not escaped. An empty text names nobody."""
    if not text:
        return []
    names = [""]
    for part in re.findall(r"\\[,\\]|.", text, re.DOTALL):
        if part == ",":
            names.append("")
        else:
            names[-1] += part[-1] if part[0] == "\\" else part
    for before, name in zip([""] + names, names):
        if not name:
            raise UsageError(f"share of {text!r} has an empty name in it")
        if "=" in before and "=" in name:
            raise UsageError(f"share of {text!r} may be one certificate or several: pass a list of "
                             "names, such as [\"CN=robot,O=Lab\"]")
        if "=" in name and not _SUBJECT.fullmatch(name):
            raise UsageError(f"{name!r} is not a certificate's subject as `raynest scenes` and the "
                             "daemon's log show it; pass a list of names, such as "
                             "[\"CN=robot,O=Lab\"]")
    return names
