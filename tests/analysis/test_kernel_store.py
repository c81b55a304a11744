"""Kernels by name: kept, published, fetched and checked; what is not what it was is refused."""

import json
import multiprocessing
import os

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.kernel_store import INDEX, Store, entry_of, index_of
from holdfast.errors import OutputError, ScenarioError
from holdfast.scenario.kernel_reference import named_kernel
from tests.served_files import served


@pytest.fixture
def web(tmp_path):
    """The address of a folder, and the folder."""
    folder = tmp_path / "web"
    folder.mkdir()
    with served(folder) as found:
        yield found.address, folder


def same(reference, kernel):
    return np.array_equal(hf.load(reference).values(), kernel[0].values())


def test_a_kernel_is_loaded_by_its_name_and_by_its_digest(store, kernel):
    entry = store.entry("cart")
    for reference in ("cart", "store:cart", f"store:{entry.sha256[:12]}"):
        assert same(reference, kernel)
    assert entry.problem["system"] == "cart"
    assert entry.licence == "CC-BY-4.0"
    assert store.verify("cart") == entry
    with pytest.raises(OutputError, match="has no kernel 'boat'; expected one of: cart"):
        hf.load("store:boat")
    with pytest.raises(OutputError, match="No such file"):
        hf.load("boat")


def test_a_scenario_names_a_kernel_of_the_store(store, kernel):
    value = named_kernel("store:cart").value()
    assert np.array_equal(value.values(), kernel[0].values())


def test_a_scenario_fetches_from_the_web_where_it_may(store, kernel, web, monkeypatch):
    address, folder = web
    store.publish(["cart"], folder)
    monkeypatch.setenv("HOLDFAST_STORE", str(folder.parent / "other"))
    with pytest.raises(ScenarioError, match=r"fetches nothing unless it may; .*HOLDFAST_FETCH=1"):
        named_kernel(f"{address}#cart")
    monkeypatch.setenv("HOLDFAST_FETCH", "1")
    value = named_kernel(f"{address}#cart").value()
    assert np.array_equal(value.values(), kernel[0].values())


def test_a_published_folder_is_read_in_place_and_from_the_web(store, kernel, web, monkeypatch):
    address, folder = web
    store.publish(["cart"], folder)
    assert same(f"{folder}#cart", kernel)
    monkeypatch.setenv("HOLDFAST_STORE", str(folder.parent / "other"))
    assert same(f"{address}#cart", kernel)
    assert list(Store().entries()) == ["cart"]
    (folder / Store().entry("cart").file).unlink()
    assert same(f"{address}/{INDEX}#cart", kernel)  # it is not fetched twice
    assert same("store:cart", kernel)


def test_two_kernels_of_one_name_from_the_web_are_both_kept(store, kernel, web, tmp_path):
    address, folder = web
    value, _ = kernel
    other = value.reported(title="another").save(tmp_path / "cart.nc")
    Store(folder).add(other, entry_of(other, value, "cart"))
    assert hf.load(f"{address}#cart").report.title == "another"
    assert hf.load("store:cart").report.title is None
    assert len(store.entries()) == 2


def test_a_wrong_digest_a_truncated_file_and_no_network_are_refused(store, web, monkeypatch):
    address, folder = web
    store.publish(["cart"], folder)
    file = folder / store.entry("cart").file
    good = file.read_bytes()
    monkeypatch.setenv("HOLDFAST_STORE", str(folder.parent / "other"))
    for bad in (good[:-1], good + b"\0", good[:500] + bytes([good[500] ^ 1]) + good[501:]):
        file.write_bytes(bad)
        with pytest.raises(
            OutputError, match=r"has not the digest that its index gives|ended after"
        ):
            hf.load(f"{address}#cart")
        with pytest.raises(OutputError, match=r"SHA-256|bytes"):
            hf.load(f"{folder}#cart")
        assert Store().entries() == {}
    assert [p.name for p in Store().folder.iterdir()] == [".lock"]
    with pytest.raises(OutputError, match="cannot be fetched"):
        hf.load("http://127.0.0.1:9/nowhere#cart")
    with pytest.raises(OutputError, match="cannot be fetched"):
        hf.load(f"{address}/nowhere#cart")


def test_a_name_of_another_kernel_is_not_taken(store, kernel, tmp_path):
    value = kernel[0].reported(title="another")
    other = value.save(tmp_path / "other.nc")
    with pytest.raises(OutputError, match="has another kernel 'cart'"):
        store.add(other, entry_of(other, value, "cart"))
    store.add(kernel[1], entry_of(kernel[1], kernel[0], "again"))
    assert len(list(store.folder.glob("*.nc"))) == 1
    store.remove("cart")
    assert same("store:again", kernel)
    store.remove("again")
    assert list(store.folder.glob("*.nc")) == []


@pytest.mark.parametrize(
    "name", ["../up", "/etc", "", "-x", "a/b", "a\\b", "x" * 81, "a" * 64, "v.nc", "a\n"]
)
def test_names_that_could_be_paths_are_refused(kernel, name):
    with pytest.raises(OutputError, match="is no name of a kernel"):
        entry_of(kernel[1], kernel[0], name)


def altered(entry, **changes):
    return {"holdfast_store": 1, "kernels": [entry | changes]}


def test_an_index_is_not_trusted(store):
    entry = json.loads((store.folder / INDEX).read_text())["kernels"][0]
    bad = [
        "", "[]", "{}", "null", "[" * 5000, '{"holdfast_store": 1, "kernels": 3}',
        '{"holdfast_store": 2, "kernels": []}',
        *(
            json.dumps(altered(entry, **change))
            for change in (
                {"sha256": "../../etc/passwd"}, {"sha256": "A" * 64}, {"bytes": -1},
                {"bytes": "9"}, {"bytes": True}, {"name": "../x"}, {"name": 3}, {"problem": []},
                {"more": 1}, {"licence": None}, {"bytes": 10**400}, {"bytes": 2**62},
                {"problem": json.loads('{"a":' * 40 + "1" + "}" * 40)},
            )
        ),
        json.dumps({"holdfast_store": 1, "kernels": [entry, entry]}),
        json.dumps({"holdfast_store": 1, "kernels": [None]}),
    ]  # fmt: skip
    for text in bad:
        with pytest.raises(OutputError):
            index_of(text, "index")


def test_an_index_that_cannot_be_read_is_refused_with_the_reason(store, monkeypatch):
    index = store.folder / INDEX
    text = index.read_bytes()
    index.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(OutputError, match="not a text file"):
        hf.load("store:cart")
    index.unlink()
    index.mkdir()
    with pytest.raises(OutputError, match="it is a folder"):
        hf.load("store:cart")
    index.rmdir()
    index.write_bytes(text)
    monkeypatch.setenv("HOLDFAST_STORE", str(index))
    with pytest.raises(OutputError, match="is not a folder"):
        hf.load("store:cart")


def test_an_index_never_grows_beyond_what_is_read(store, kernel, monkeypatch):
    value, path = kernel
    before = (store.folder / INDEX).read_text()
    monkeypatch.setattr("holdfast.analysis.kernel_store.MOST_INDEX", 3000)
    with pytest.raises(OutputError, match="would be larger"):
        store.add(path, entry_of(path, value, "long", "x" * 3000))
    assert (store.folder / INDEX).read_text() == before


def test_texts_stay_where_a_kernel_is_added_again(store, kernel):
    value, path = kernel
    assert store.add(path, entry_of(path, value, "cart")).licence == "CC-BY-4.0"
    again = store.add(path, entry_of(path, value, "cart", citation="Doe 2027"))
    assert (again.licence, again.citation) == ("CC-BY-4.0", "Doe 2027")


def test_all_names_are_checked_before_any_is_published(store, kernel, tmp_path):
    with pytest.raises(OutputError, match="has no kernel 'boat'"):
        store.publish(["cart", "boat"], tmp_path / "paper")
    assert not (tmp_path / "paper").exists()


def test_what_no_process_finished_is_told(store, kernel):
    assert store.unnamed() == []
    lost = store.folder / f"{'a' * 64}.nc"
    part = store.folder / f".{'b' * 64}.part"
    for path in (lost, part, store.folder / "mine.nc"):
        path.write_bytes(b"x")
    assert store.unnamed() == [lost, part]


@pytest.mark.parametrize("text", ["x" * 300, "x#" + "y" * 300, "x/" * 3000 + "#y", "a\0b", "a\0#b"])
def test_texts_that_are_no_paths_are_refused(store, text):
    with pytest.raises(OutputError):
        hf.load(text)


def test_a_folder_whose_name_has_a_mark_is_read(store, kernel, tmp_path):
    folder = tmp_path / "run#3"
    store.publish(["cart"], folder)
    assert same(f"{folder}#cart", kernel)
    assert same(f"{folder}#", kernel)
    assert same(str(kernel[0].save(tmp_path / "a#b.nc")), kernel)
    with pytest.raises(OutputError, match="No such file"):
        hf.load(tmp_path / "a#c.nc")


def test_a_link_in_a_published_folder_shows_no_other_file(store, tmp_path):
    folder = tmp_path / "paper"
    store.publish(["cart"], folder)
    path = folder / store.entry("cart").file
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(path.stat().st_size))
    path.unlink()
    path.symlink_to(secret)
    with pytest.raises(OutputError, match="SHA-256"):
        hf.load(f"{folder}#cart")


def test_a_damaged_file_of_the_store_is_found(store):
    path = store.path("cart")
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(OutputError, match="SHA-256"):
        store.verify("cart")
    path.write_bytes(data[:-5])
    for reference in ("store:cart", "cart"):
        with pytest.raises(OutputError, match="bytes"):
            hf.load(reference)
    path.unlink()
    with pytest.raises(OutputError, match="is missing"):
        hf.load("store:cart")


def added(folder, path, entries):
    for entry in entries:
        Store(folder).add(path, entry)


def test_processes_that_add_at_once_lose_nothing(tmp_path, kernel):
    value, path = kernel
    context = multiprocessing.get_context("fork")
    entries = [[entry_of(path, value, f"k{i}-{j}") for j in range(5)] for i in range(3)]
    workers = [
        context.Process(target=added, args=(tmp_path / "store", path, mine)) for mine in entries
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(100)
    assert len(Store(tmp_path / "store").entries()) == 15


@pytest.mark.skipif(os.geteuid() == 0, reason="the administrator may write anywhere")
def test_a_store_that_cannot_be_written_is_read(store, kernel):
    store.folder.chmod(0o500)
    try:
        assert same("store:cart", kernel)
        with pytest.raises(OutputError, match="cannot be written"):
            store.remove("cart")
    finally:
        store.folder.chmod(0o700)
