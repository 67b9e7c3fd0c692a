"""One namespace for all arrays; lengths of FFTs; memory is estimated before it is taken, within what may be used."""

import sys

import numpy as np
import pytest
import scipy.fft

from simulator import arrays as memory
from simulator.arrays import SHARE, machine_bytes, namespace, next_fast_len, require_memory
from simulator.errors import InputError


def test_lengths_are_scipys():
    lengths = [*range(1, 3000), 65537, 999_983, 12_345_678]
    assert [next_fast_len(n) for n in lengths] == [scipy.fft.next_fast_len(n, real=True) for n in lengths]


def test_arrays_of_two_kinds_are_refused():
    torch = pytest.importorskip("torch")
    with pytest.raises(TypeError, match="Multiple namespaces"):
        namespace(np.ones(3), torch.ones(3))


def test_the_estimate_is_what_numpy_would_take():
    """Two and a half complex64 fields of 3000 x 2000."""
    assert require_memory("width_mm", (3000, 2000), 2.5, 8, "") == 3000 * 2000 * 8 * 2.5


def test_a_grid_beyond_the_machine_is_refused_without_taking_it():
    """A petabyte: it would not survive an attempt."""
    with pytest.raises(InputError, match=r"^width_mm: "):
        require_memory("width_mm", (10**7, 10**7), 1, 8, "narrow it")


def test_a_container_may_allow_less_than_the_machine_has(tmp_path, monkeypatch):
    physical = machine_bytes()
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(memory, "_CONTROL_GROUPS", (tmp_path / "absent", limit))
    limit.write_text("1000000\n")
    assert machine_bytes() == 1_000_000
    with pytest.raises(InputError, match=r"^oversampling: "):
        require_memory("oversampling", (400, 400), 1, 8, "")
    assert require_memory("oversampling", (1, int(SHARE * 1e6) // 8), 1, 8, "") == SHARE * 1e6
    limit.write_text("max\n")
    assert machine_bytes() >= physical


def test_a_machine_that_does_not_tell_is_not_limited(monkeypatch):
    monkeypatch.setattr(memory, "_CONTROL_GROUPS", ())
    monkeypatch.setattr(memory.os, "sysconf_names", {})
    assert machine_bytes() == sys.maxsize
