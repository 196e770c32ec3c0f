"""The list of faults is sound: each stands once in its file, and its tests exist. `make mutation` puts them in."""

import pytest

from tests.mutate import ROOT, Mutation, load_mutations

N_LEAST = 50


def test_there_are_enough() -> None:
    assert len(load_mutations()) >= N_LEAST


@pytest.mark.parametrize("mutation", load_mutations(), ids=lambda m: f"{m.file}: {m.old[:40]}")
def test_a_fault_can_be_put_in(mutation: Mutation) -> None:
    assert (ROOT / mutation.file).read_text(encoding="utf-8").count(mutation.old) == 1
    assert mutation.new != mutation.old
    assert (ROOT / mutation.tests.split()[0]).is_file()
