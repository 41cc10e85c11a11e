"""Compiled loops are kept, and made again when any file that they come from changes."""

from __future__ import annotations

from pathlib import Path

import pytest
from numba.core import config

from pedzoo.maps.walls import compiled as loops


def test_a_changed_file_gives_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "pedzoo"
    home = root / "maps" / "walls"
    home.mkdir(parents=True)
    (home / "compiled.py").write_text("jit = compiled()\n")
    (home / "caller.py").write_text(
        "from pedzoo.maps.walls.compiled import jit\nfrom pedzoo.maps.walls.lengths import A\n"
    )
    (home / "lengths.py").write_text("A = 1\n")
    (home / "other.py").write_text("B = 1\n")
    monkeypatch.setattr(loops, "__file__", str(home / "compiled.py"))

    def folder() -> str:
        loops._cache_folder.cache_clear()
        return loops._cache_folder()

    try:
        first = folder()
        assert Path(first).is_dir() and Path(first).is_relative_to(root)
        (home / "other.py").write_text("B = 2\n")
        assert folder() == first
        (home / "lengths.py").write_text("A = 2\n")
        second = folder()
        assert second != first
        (home / "caller.py").write_text("from pedzoo.maps.walls.compiled import jit\n")
        assert folder() not in (first, second)
    finally:
        loops._cache_folder.cache_clear()


def test_other_users_of_numba_keep_their_folder() -> None:
    before = vars(config)["CACHE_DIR"]
    assert loops.compiled("f8(f8)")(lambda x: x + 1)(1.0) == 2.0
    assert vars(config)["CACHE_DIR"] == before
