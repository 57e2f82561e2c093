"""What is learned from of a run on a machine that stands still now and then."""

from __future__ import annotations

import numpy as np

from tsa_ctrl.tune.run import SHORTEST_PIECE, _pieces

PERIOD = 1e-3  # s


def columns(t: np.ndarray) -> dict[str, np.ndarray]:
    angle = 2.0 * np.pi * 0.5 * t
    return {"t": t, "tau_m": np.sin(angle), "tau_j": np.sin(angle), "omega_j": np.cos(angle)}


def test_a_run_without_gaps_is_one_piece_with_the_logs_hash() -> None:
    (piece,) = _pieces(columns(PERIOD * np.arange(4000)), "run", "hash")
    assert piece.sha256 == "hash"
    assert len(piece) == 4000


def test_a_long_gap_parts_a_run_and_short_ends_are_left_out() -> None:
    t = np.concatenate([PERIOD * np.arange(4000), 4.5 + PERIOD * np.arange(3000), 8.0 + PERIOD * np.arange(500)])
    pieces = _pieces(columns(t), "run", "hash")
    assert [len(piece) for piece in pieces] == [4000, 3000]
    assert [piece.name for piece in pieces] == ["run-1", "run-2"]
    assert SHORTEST_PIECE > 500 * PERIOD


def test_a_stretch_with_so_many_missing_cycles_that_it_is_on_no_grid_is_left_out() -> None:
    sparse = 2.0 * PERIOD * np.arange(1500)  # every other cycle, and then all of them
    t = np.concatenate([sparse, sparse[-1] + PERIOD * np.arange(1, 900), 6.0 + PERIOD * np.arange(3000)])
    (piece,) = _pieces(columns(t), "run", "hash")
    assert len(piece) == 3000
