import numpy as np
import pytest
import torch

from saltus.controller.gait import GaitState

TICK_S = 0.002


def schedule(frequency, seconds):
    state = GaitState(phase=np.zeros(()))
    signals = []
    for _ in range(int(seconds / TICK_S)):
        state = state.advanced(np.asarray(frequency), TICK_S)
        signals.append((state, state.read(np.asarray(frequency))))
    return signals


def runs(flags):
    """Lengths of the uninterrupted stretches of True that begin and end inside."""
    edges = np.flatnonzero(np.diff(flags.astype(int)))
    starts = [e for e in edges if not flags[e]]
    ends = [e for e in edges if flags[e]]
    return [
        end - start
        for start in starts
        for end in [next((e for e in ends if e > start), None)]
        if end is not None
    ]


@pytest.mark.parametrize("frequency", [0.5, 1.0, 2.3, 3.999])
def test_pairs_never_stand_together_after_the_start_and_stand_for_the_right_time(frequency):
    signals = schedule(frequency, 6.0 / frequency)
    contact = np.array([signal.contact for _, signal in signals])
    phase = np.array([float(state.phase) for state, _ in signals])
    started = phase >= 0.8
    assert (contact[:, 0] == contact[:, 1]).all()
    assert (contact[:, 2] == contact[:, 3]).all()
    assert not (contact[:, 0] & contact[:, 2])[started].any()
    for leg in range(4):
        lengths = np.array(runs(contact[started, leg])) * TICK_S
        assert len(lengths) >= 3
        np.testing.assert_allclose(lengths, 0.4 / frequency, atol=1.01 * TICK_S)
    np.testing.assert_allclose(signals[0][1].stance_duration, 0.4 / frequency)


def test_four_modes_in_their_places():
    cycle = np.arange(2.0, 3.0, 0.001) + 0.0005
    signal = GaitState(phase=cycle).read(np.ones_like(cycle))
    share = cycle - 2.0
    front, rear = signal.contact[:, 0], signal.contact[:, 2]
    np.testing.assert_array_equal(front, (share < 0.35) | (share >= 0.95))
    np.testing.assert_array_equal(rear, (share >= 0.40) & (share < 0.80))
    np.testing.assert_allclose(np.mean(~front & ~rear), 0.20, atol=0.002)
    np.testing.assert_allclose(np.mean(signal.trusted[:, 0]), 0.20, atol=0.002)
    assert not (signal.trusted & ~signal.contact).any()


def test_legs_wait_on_the_ground_for_their_first_stance():
    phase = np.arange(0.0, 0.40, 0.01)
    signal = GaitState(phase=phase).read(np.ones_like(phase))
    assert signal.contact[:, 2:].all()
    assert signal.trusted[:, 2:].all()
    assert signal.contact[phase < 0.35].all()


def test_progress_rises_from_zero_to_one_in_each_stance_and_swing():
    signals = schedule(2.0, 4.0)
    contact = np.array([signal.contact for _, signal in signals])
    progress = np.array([signal.progress for _, signal in signals])
    assert (progress >= 0.0).all()
    assert (progress < 1.0).all()
    same = contact[1:] == contact[:-1]
    waiting = (np.array([float(s.phase) for s, _ in signals]) < 0.41)[1:, None]
    falls = (np.diff(progress, axis=0) <= 0.0) & same & ~waiting
    assert not falls.any()
    switches = ~same
    assert (progress[1:][switches] < 0.02).all()


def test_state_is_not_changed_and_numpy_equals_torch():
    phase = np.linspace(0.0, 3.0, 301)
    state = GaitState(phase=phase.copy())
    moved = state.advanced(np.full_like(phase, 2.0), TICK_S)
    np.testing.assert_array_equal(state.phase, phase)
    ours = moved.read(np.full_like(phase, 2.0))
    state = GaitState(phase=torch.as_tensor(moved.phase))
    theirs = state.read(torch.full((301,), 2.0, dtype=torch.float64))
    for name in ("contact", "progress", "trusted", "cycle", "stance_duration"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name).numpy())
