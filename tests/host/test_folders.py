"""Folders of results that stay empty are not left behind."""

from holdfast.host.files import discard_unfinished, make_folder


def test_a_folder_that_stays_empty_is_removed_when_the_process_ends(tmp_path):
    (tmp_path / "own").mkdir()
    for name in ("a/b/c", "a/d", "own", "own/e"):
        make_folder(tmp_path / name)
    (tmp_path / "a" / "d" / "file").touch()
    discard_unfinished()
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == [
        "a", "a/d", "a/d/file", "own",
    ]  # fmt: skip
