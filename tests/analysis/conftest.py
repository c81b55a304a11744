"""A kernel in a file, and the store of a user that has it."""

import pytest

from tests.stored_cart import kept_cart, saved_cart


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    return saved_cart(tmp_path_factory.mktemp("kernel"))


@pytest.fixture
def store(tmp_path, monkeypatch, kernel):
    monkeypatch.setenv("HOLDFAST_STORE", str(tmp_path / "store"))
    return kept_cart(*kernel)
