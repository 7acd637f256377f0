"""The JSON document in a folder says what it is, in which version and frame; reading checks that."""

import json
from pathlib import Path
from typing import Any

from dwgs.scene import InputError


def write_document(content: dict[str, Any], stamp: dict[str, Any], path: Path) -> None:
    """Write ``stamp`` (what every document of this format says alike) and then ``content``.

    Numbers come back exactly: JSON holds the shortest decimal that is the same float64.
    """
    try:
        text = json.dumps({**stamp, **content}, indent=2, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"'{path.name}' holds finite JSON values only: {error}") from error
    path.write_text(text + "\n", encoding="utf-8")


def read_document(stamp: dict[str, Any], path: Path) -> dict[str, Any]:
    """The document at ``path``; `InputError` where it is missing, no JSON, or differs from ``stamp``."""
    if not path.is_file():
        raise InputError(f"'{path.parent}' has no {path.name}: it is no {stamp['format']} folder, or an incomplete one")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"'{path}' is not JSON: {error}") from error
    for key, value in stamp.items():
        said = document.get(key) if isinstance(document, dict) else None
        if said != value:
            raise InputError(f"'{path}' says {key} = {json.dumps(said)}, this version reads {json.dumps(value)}")
    return document
