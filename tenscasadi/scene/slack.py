"""Field `slack` of a scene: one string law, or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from tenscasadi.scene.strings import Clip, StringLaw
from tenscasadi.util.validate import as_tuple, instance, node_index


def read_slack(given: Any, strings: int) -> StringLaw | tuple[StringLaw, ...]:
    """Convert the field `Scene.slack` to one string law or several.

    `given` is a law, or a sequence or mapping of laws for the given number of strings. Strings that
    a mapping does not name have `Clip()`. Returns a tuple only if laws differ. Raises TypeError or
    ValueError.
    """
    example = (
        "Clip(), Smooth(width), Linear(), or one of them for each string, such as {3: Linear()}"
    )
    if isinstance(given, StringLaw):
        return given
    if isinstance(given, Mapping):
        laws: list[Any] = [Clip()] * strings
        for key, law in given.items():
            laws[node_index("Scene.slack, string", key, strings, "string")] = law
    else:
        if isinstance(given, (str, bytes)) or not isinstance(given, Sequence):
            instance("Scene.slack", given, StringLaw, example)
        laws = list(as_tuple("Scene.slack", given, example))
        if len(laws) != strings:
            raise ValueError(
                f"Scene.slack has {len(laws)} entries: "
                f"give one law, or one for each of {strings} strings"
            )
    for string, law in enumerate(laws):
        instance(f"Scene.slack[{string}]", law, StringLaw, "Clip(), Smooth(width) or Linear()")
    if not laws:
        return Clip()
    return cast(StringLaw, laws[0]) if len(set(laws)) == 1 else tuple(laws)
