# SPDX-License-Identifier: GPL-3.0-or-later
"""A time budget is kept by the times of recent updates. Time comes from a cost model; no test reads a clock."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.cost_curve import CostCurve
from adaptive_terrain.cbt_terrain.accuracy.time_correction import TimeCorrection

CURVE = CostCurve("px", (16.0, 4.0, 1.0), (500.0, 2000.0, 8000.0), (1.0, 4.0, 16.0))
BUDGET = 8.0


def fly(cost, frames: int) -> tuple[np.ndarray, list[float]]:
    """Return each update's time over the budget, and the errors; `cost` gives milliseconds of (frame, error)."""
    correction, times, errors = TimeCorrection(), [], []
    for frame in range(frames):
        errors.append(correction.error_for_ms(CURVE, BUDGET))
        times.append(cost(frame, errors[-1]))
        correction.record(CURVE, errors[-1], times[-1])
    return np.array(times) / BUDGET, errors


@pytest.mark.parametrize("slowness", [0.5, 0.68, 1.36, 3.0])
def test_a_slower_or_faster_machine_keeps_the_budget(slowness):
    times, errors = fly(lambda frame, error: slowness * CURVE.at(error)[1], 10)
    assert times[:3] == pytest.approx(slowness, rel=1e-3) and times[3:] == pytest.approx(1.0, rel=1e-3)
    assert len(set(errors)) == 2, "an error that keeps the budget stays"


def test_a_flight_over_changing_ground_keeps_the_budget():
    """The cost swings between 0.68 and 1.36 of the curve's, with 2 % of noise and an update in 20 that takes three
    times as long."""
    rng = np.random.default_rng(0)
    noise, spikes = 1 + 0.02 * rng.standard_normal(400), np.where(rng.random(400) < 0.05, 3.0, 1.0)
    swing = np.sqrt(0.68 * 1.36) * (1.36 / 0.68) ** (0.5 * np.sin(np.linspace(0, 4 * np.pi, 400)))
    times, _ = fly(lambda frame, error: swing[frame] * noise[frame] * spikes[frame] * CURVE.at(error)[1], 400)
    usual = times[3:][spikes[3:] == 1.0]
    assert np.abs(np.quantile(usual, [0.05, 0.5, 0.95]) - 1).max() < 0.1
    assert usual.mean() == pytest.approx(1.0, abs=0.03) and swing.max() > 1.35


def test_a_curve_of_the_wrong_slope_is_corrected():
    times, _ = fly(lambda frame, error: 30.0 * error**-1.4, 40)
    assert times[20:] == pytest.approx(1.0, abs=0.05)


def test_one_slow_update_changes_no_error():
    _, errors = fly(lambda frame, error: CURVE.at(error)[1] * (20.0 if frame in (0, 7) else 1.01), 20)
    assert len(set(errors)) == 1
