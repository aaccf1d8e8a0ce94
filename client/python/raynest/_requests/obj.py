"""The names of the files that an OBJ and its MTL files name, read from text that may be hostile."""
from __future__ import annotations

import re
from typing import Optional

from .gltf import file_of_uri

_NUMBER = rb"[-+.0-9eE]+"
# Options of a map before its file's name: "-s 2 2 1 leaf.png".
_OPTION = re.compile(rb"-mm(?:[ \t]+" + _NUMBER + rb"){0,2}[ \t]+"
                     rb"|-[sot](?:[ \t]+" + _NUMBER + rb"){0,3}[ \t]+"
                     rb"|-[a-z]+[ \t]+[^ \t]+[ \t]+")
# Windows programs write a mark of three bytes before UTF-8.
_LINES = {".obj": re.compile(rb"^(?:\xef\xbb\xbf)?[ \t]*mtllib[ \t]+([^\r\n]+)", re.M),
          ".mtl": re.compile(rb"^(?:\xef\xbb\xbf)?[ \t]*map_Kd[ \t]+([^\r\n]+)", re.M)}


def names_in(file: str, data: bytes) -> list[str]:
    """Returns the MTL files of an .obj, or the pictures of an .mtl, each once, beneath the scene's
    folder; `file` is the name of the file itself. Names outside the folder are left out: the daemon
    complains of them."""
    lines = _LINES.get(file[-4:].lower())
    names: dict[str, None] = {}
    for match in lines.finditer(data) if lines else ():
        rest = match[1].strip()
        while file[-4:].lower() == ".mtl" and rest.startswith(b"-"):
            option = _OPTION.match(rest)
            rest = rest[option.end():] if option else b""
        words = rest.split() if file[-4:].lower() == ".obj" else []
        # Several files, or one whose name has blanks.
        for named in words if words and all(word.lower().endswith(b".mtl") for word in words) else [rest]:
            name = file_of_name(file, named.decode("utf-8", "surrogateescape"))
            if name is not None:
                names.setdefault(name)
    return list(names)


def file_of_name(by: str, text: str) -> Optional[str]:
    """Returns the name beneath the scene's folder of the file that `text` of the file `by` names; None
    if it is absolute or leaves that folder."""
    if text.startswith(("/", "\\")):
        return None
    return file_of_uri((by[:by.rfind("/") + 1] + text).replace("%", "%25"))
