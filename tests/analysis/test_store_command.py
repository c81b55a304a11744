"""`holdfast store`: what it keeps, says and refuses."""

import dataclasses

import netCDF4
import numpy as np
from click.testing import CliRunner

import holdfast as hf
from holdfast.analysis.kernel_store import INDEX, Store, entry_of, index_text
from holdfast.commands.store import command


def test_the_command_adds_shows_checks_publishes_and_removes(tmp_path, kernel, monkeypatch):
    monkeypatch.setenv("HOLDFAST_STORE", str(tmp_path / "store"))
    run = CliRunner().invoke

    def said(*arguments):
        done = run(command, [str(a) for a in arguments], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    assert "has no kernels" in said("list")
    assert "added: cart" in said("add", kernel[1], "--licence", "CC0", "--citation", "Doe")
    assert "discriminating-kernel of cart" in said("list")
    assert '"licence": "CC0"' in said("show", "cart")
    assert "as it was added: cart" in said("verify")
    assert "#NAME" in said("publish", tmp_path / "paper", "cart")
    assert "added: copy" in said("add", f"{tmp_path / 'paper'}#cart", "--name", "copy")
    assert "removed: cart" in said("remove", "cart")
    assert np.array_equal(hf.load("store:copy").values(), kernel[0].values())


def test_the_command_checks_all_and_shows_what_is_wrong(store, kernel, tmp_path):
    def said(*arguments):
        return CliRunner().invoke(command, [str(a) for a in arguments])

    value = kernel[0]
    other = value.reported(title="another").save(tmp_path / "my kernel.nc")
    done = said("add", other)
    assert "give --name" in str(done.exception)
    store.add(other, entry_of(other, value, "boat"))
    store.path("boat").write_bytes(b"x" * store.entry("boat").bytes)
    (store.folder / f"{'a' * 64}.nc").write_bytes(b"x")
    done = said("verify")
    assert "as it was added: cart" in done.output
    assert "no name has" in done.output
    assert "'boat' has the SHA-256" in str(done.exception)
    assert "no name has" not in said("verify", "cart").output


def test_a_kernel_of_a_folder_keeps_its_texts_under_another_name(store, tmp_path, monkeypatch):
    store.publish(["cart"], tmp_path / "paper")
    monkeypatch.setenv("HOLDFAST_STORE", str(tmp_path / "other"))
    for name in ([], ["--name", "copy"]):
        CliRunner().invoke(command, ["add", f"{tmp_path / 'paper'}#cart", *name])
    entries = Store().entries()
    assert [e.licence for e in entries.values()] == ["CC-BY-4.0"] * 2
    assert sorted(entries) == ["cart", "copy"]


def test_a_list_prints_nothing_that_a_terminal_obeys(store):
    entry = store.entry("cart")
    bad = dataclasses.replace(entry, problem={"kind": "\x1b[2Jx\n", "system": "s"})
    (store.folder / INDEX).write_text(index_text({"cart": bad}))
    shown = CliRunner().invoke(command, ["list"], color=True).output
    assert "?[2Jx? of s" in shown
    assert "\x1b" not in shown


def test_a_file_that_says_nonsense_of_its_problem_is_refused(store, kernel, tmp_path):
    path = tmp_path / "odd.nc"
    path.write_bytes(kernel[1].read_bytes())
    with netCDF4.Dataset(path, "a") as file:
        file.parameters = "no table"
    done = CliRunner().invoke(command, ["add", str(path)])
    assert "says of its problem cannot be read" in str(done.exception)
