"""What machine code computes here is compared with physics, not with other machine code: the compiler need not try hard."""

from __future__ import annotations

import pytest

from tenscasadi.util import compile as compiled

usual_flags = compiled._default_flags


@pytest.fixture(autouse=True)
def quick_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flags of users but for the level, which changes no rounding; other tests compile as users do."""
    monkeypatch.setattr(
        compiled, "_default_flags", lambda compiler: ("-O1", *usual_flags(compiler)[1:])
    )
