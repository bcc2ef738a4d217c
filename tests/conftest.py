"""Collect garbage after each test: PETSc objects freed late are freed in a different order on different ranks."""

import gc

import pytest


@pytest.fixture(autouse=True)
def collect_garbage():
    yield
    gc.collect()
