"""Test when compiled code is reused."""

from __future__ import annotations

from pathlib import Path

from tsa_ctrl.plant import compiled


def test_every_source_of_compiled_code_counts() -> None:
    """A change of a file with a compiled function leads to another cache."""
    folder = Path(compiled.__file__).parent
    sources = {path.name for path in folder.glob("*.py") if "\n@compiled\n" in path.read_text(encoding="utf-8")}
    assert sources <= set(compiled._KERNELS)
    assert all((folder / name).exists() for name in compiled._KERNELS)
