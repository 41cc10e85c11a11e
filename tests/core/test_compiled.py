"""Compiled functions are kept, and made again when any file that they come from changes."""

from pathlib import Path

from numba.core import config

from pedzoo.core import compiled as loops


def test_a_changed_file_gives_another_cache_folder(tmp_path, monkeypatch) -> None:
    root = tmp_path / "pedzoo"
    (root / "core").mkdir(parents=True)
    loop = "from pedzoo.core.compiled import jit\n"
    (root / "caller.py").write_text(loop + "from pedzoo.lengths import A\n")
    for name in ("lengths", "other"):
        (root / f"{name}.py").write_text("A = 1\n")
    monkeypatch.setattr(loops, "__file__", str(root / "core" / "compiled.py"))

    def folder() -> str:
        loops._cache_folder.cache_clear()
        return loops._cache_folder()

    try:
        first = folder()
        assert Path(first).is_dir() and Path(first).is_relative_to(root)
        (root / "other.py").write_text("A = 2\n")
        assert folder() == first
        (root / "lengths.py").write_text("A = 2\n")
        second = folder()
        assert second != first
        (root / "caller.py").write_text(loop)
        assert folder() not in (first, second)
    finally:
        loops._cache_folder.cache_clear()


def test_other_users_of_numba_keep_their_folder() -> None:
    before = vars(config)["CACHE_DIR"]
    assert loops.compiled("f8(f8)")(lambda x: x + 1)(1.0) == 2.0
    assert vars(config)["CACHE_DIR"] == before
