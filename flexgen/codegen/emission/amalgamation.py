"""The library as two files: one public header and one C file that hold the text of all others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath

_INCLUDE = '#include "'


def merge_files(name: str, files: Mapping[str, str]) -> dict[str, str]:
    """The files of a library, with its headers and sources put together.

    Parameters
    ----------
    name : str
        Of the library.
    files : mapping of str to str
        What `flexgen.codegen.emission.emit.emit` writes.

    Returns
    -------
    dict of str to str
        ``<name>.h``, ``<name>.c`` and ``example.c``. The C is the same, so that the results have
        the same bits.
    """
    public = [file for file in files if file.endswith(".h") and "/" not in file]
    sources = [file for file in files if "/" in file and file.endswith(".c")]
    by_name = {PurePosixPath(file).name: text for file, text in files.items()}
    header = "\n".join(_without(files[file], set(public)) for file in public)
    merged = _Merged(
        {key: text for key, text in by_name.items() if key not in public}, set(public)
    )
    # the fixed files first: the functions define macros with short names
    order = sorted(
        sources, key=lambda file: (f'#include "{name}_undefine.h"' in files[file], file)
    )
    body = "\n".join(merged.text(PurePosixPath(file).name) for file in order)
    note = (
        f"/* {name}: the sources of the library in one file. Written by flexgen; see {name}.h. */"
    )
    text = f'{note}\n#include "{name}.h"\n\n{body}'
    example = files["example.c"].replace(
        "-I. example.c $(find src -name '*.c')", f"example.c {name}.c"
    )
    for file in public:
        example = example.replace(f'#include "{file}"', f'#include "{name}.h"')
    return {f"{name}.h": header, f"{name}.c": text, "example.c": example}


def merge_text(file: str, texts: Mapping[str, str]) -> str:
    """The text of one of these files, with those of them that it includes put in."""
    return _Merged(texts, set()).text(file)


def _find_include(line: str) -> str | None:
    """Name of the file that a line includes in quotes, without its folder; None for every other
    line.
    """
    return (
        PurePosixPath(line[len(_INCLUDE) :].rstrip().rstrip('"')).name
        if line.startswith(_INCLUDE)
        else None
    )


def _without(text: str, names: set[str]) -> str:
    """A text without the lines that include these files."""
    return "".join(
        line for line in text.splitlines(keepends=True) if _find_include(line) not in names
    )


class _Merged:
    """Texts with the texts that they include put in; a file with an include guard is put in once.

    Parameters
    ----------
    texts : mapping of str to str
        By file name.
    public : set of str
        Headers that the merged text includes at its top.
    """

    def __init__(self, texts: Mapping[str, str], public: set[str]) -> None:
        self._texts = dict(texts)
        self._public = public
        self._seen: set[str] = set()

    def text(self, file: str) -> str:
        """The text of a file and of all that it includes; empty for a guarded file that is there
        already.
        """
        text = self._texts[file]
        if file in self._seen:
            return ""
        if any(
            line.startswith("#ifndef ") and line.rstrip().endswith("_H")
            for line in text.splitlines()
        ):
            self._seen.add(file)
        out = []
        for line in text.splitlines(keepends=True):
            included = _find_include(line)
            if included is None:
                out.append(line)
            elif included not in self._public:
                out.append(self.text(included))
        return "".join(out)
