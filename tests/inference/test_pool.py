"""The pooling of footfalls against the joint normal distribution written out in full."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.inference import pool as module
from terraphi.inference.pool import Anchor, Normal, Observed, covariance, pool
from terraphi.inference.touchdowns import Prior

N = 24  # gains and frictions of twelve joints
SHARED = [*map(str, range(N)), *Prior().shared()]
M = len(SHARED)
FIELD = (1.2, 0.8)


@pytest.fixture(autouse=True)
def known_field(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    if "learned" in request.node.name:
        return
    monkeypatch.setattr(module, "_learned", lambda *_: (*FIELD, 0.0))


def problem() -> tuple[Observed, Normal, np.ndarray]:
    rng = np.random.default_rng(3)
    place = np.column_stack([np.linspace(0.0, 3.0, 24), rng.normal(0.0, 0.1, 24)])
    shared = rng.normal(0.0, 1.0, (24, M))
    shared[:, SHARED.index("law_offset_deg")] = 1.0
    root = rng.normal(0.0, 0.05, (M, M))
    full = root @ root.T + 0.01 * np.eye(M)
    full[:N, N:] = full[N:, :N] = 0.0
    mean = np.concatenate([rng.normal(0.0, 0.1, N), np.zeros(M - N)])
    phi = 33.0 + np.sin(place[:, 0]) + rng.normal(0.0, 0.2, 24)
    return Observed(phi, np.full(24, 0.2), shared, place), Normal(mean, full), place[::6] + 0.05


def test_bands_are_the_exact_posterior() -> None:
    observed, shared, path = problem()
    pooled = pool(observed, shared, path, [], torques=N, mean=32.0, mean_sd=8.0)
    # Footfalls first determine the errors of the torques, by the normal equations.
    each, before = observed.shared[:, :N], np.linalg.inv(shared.covariance[:N, :N])
    field = covariance(observed.place, observed.place, *FIELD, 8.0) + observed.sd**2 * np.eye(24)
    weighted = each.T @ np.linalg.inv(field)
    off = observed.phi - 32.0 - observed.shared[:, N:] @ shared.mean[N:]
    torques = np.linalg.inv(before + weighted @ each)
    shared.mean[:N] = torques @ (before @ shared.mean[:N] + weighted @ off)
    shared.covariance[:N, :N] = torques
    values = np.concatenate([path, observed.place])
    prior = covariance(values, values, *FIELD, 8.0)
    p = len(path)
    rows = np.hstack([np.zeros((24, p)), np.eye(24)])
    noise = observed.sd**2 * np.eye(24)
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + noise)
    mean = 32.0 + gain @ (observed.phi - observed.shared @ shared.mean - 32.0)
    moves = (gain @ observed.shared)[:p]
    left = (prior - gain @ rows @ prior)[:p, :p]
    # Of what is shared, the relative band holds what differs from the mean of the path.
    difference = (np.eye(p) - np.full((p, p), 1.0 / p)) @ moves
    unlike = difference @ shared.covariance @ difference.T
    everything = moves @ shared.covariance @ moves.T
    assert pooled.path_phi == pytest.approx(mean[:p])
    assert pooled.path_relative_sd == pytest.approx(np.sqrt(np.diag(left + unlike)))
    assert pooled.path_absolute_sd == pytest.approx(np.sqrt(np.diag(left + everything)))
    assert pooled.shared[0] == pytest.approx(shared.mean)
    assert np.all(pooled.path_absolute_sd > pooled.path_relative_sd)
    each = observed.shared - observed.shared.mean(axis=0)
    reference = observed.sd**2 + np.diag(each @ shared.covariance @ each.T)
    assert pooled.sd == pytest.approx(np.sqrt(reference))
    everything = np.diag(observed.shared @ shared.covariance @ observed.shared.T)
    full = np.maximum(reference, observed.sd**2 + everything)
    assert np.hypot(pooled.sd, pooled.shared_sd) == pytest.approx(np.sqrt(full))


def test_an_anchor_of_some_doubt_is_weighed_by_its_variance() -> None:
    observed, shared, path = problem()
    free = pool(observed, shared, path, [], torques=N, mean=32.0, mean_sd=8.0)
    held = pool(
        observed,
        shared,
        path,
        [(Anchor(0.0, 0.5, 30.0, 0.5), path[:1])],
        torques=N,
        mean=32.0,
        mean_sd=8.0,
    )
    reference, given = free.path_absolute_sd[0] ** 2, 0.5**2
    mean = (free.path_phi[0] * given + 30.0 * reference) / (reference + given)
    assert held.path_phi[0] == pytest.approx(mean)
    assert held.path_absolute_sd[0] == pytest.approx(
        np.sqrt(reference * given / (reference + given))
    )


def test_an_anchor_takes_what_is_shared_away() -> None:
    """All are high by the law's offset: a sure anchor tells by how much, and the map follows."""
    observed, _, path = problem()
    only = np.zeros((M, M))
    only[SHARED.index("law_offset_deg"), SHARED.index("law_offset_deg")] = 9.0
    observed = observed._replace(shared=np.tile(np.eye(M)[SHARED.index("law_offset_deg")], (24, 1)))
    shared = Normal(np.zeros(M), only)
    free = pool(observed, shared, path, [], torques=N, mean=32.0, mean_sd=8.0)
    anchor = Anchor(0.0, 0.5, float(free.path_phi[0]) - 4.0, 0.01)
    held = pool(observed, shared, path, [(anchor, path[:1])], torques=N, mean=32.0, mean_sd=8.0)
    assert free.path_absolute_sd == pytest.approx(np.hypot(free.path_relative_sd, 3.0), rel=1e-3)
    assert held.path_phi == pytest.approx(free.path_phi - 4.0, abs=0.1)
    assert held.phi == pytest.approx(free.phi - 4.0, abs=0.1)
    assert held.path_absolute_sd.max() < 0.5
    assert held.shared_sd.max() < 0.5


def test_feet_teach_the_gains_that_differ_between_them() -> None:
    """Two feet by turns on even ground, one of them high: its gain takes the difference."""
    place = np.column_stack([np.linspace(0.0, 2.0, 40), np.zeros(40)])
    shared = np.zeros((40, M))
    shared[::2, 2], shared[1::2, 5] = 6.0, 6.0
    phi = np.where(np.arange(40) % 2, 33.0, 33.6)
    sd = np.zeros(M)
    sd[[2, 5]] = 0.1
    observation = Observed(phi, np.full(40, 0.1), shared, place)
    pooled = pool(
        observation,
        Normal(np.zeros(M), np.diag(sd**2)),
        place[:3],
        [],
        torques=N,
        mean=32.0,
        mean_sd=8.0,
    )
    assert pooled.shared[0][2] - pooled.shared[0][5] == pytest.approx(0.1, abs=0.01)
    assert np.ptp(pooled.phi) < 0.1
    assert pooled.shared_sd.min() > 0.2  # what both have in common is not known


def test_two_anchors_find_the_scale_of_differences() -> None:
    """The law reads differences of φ half as large as they are: two known places mend that."""
    x = np.linspace(0.0, 3.0, 60)
    place, true = np.column_stack([x, 0.0 * x]), 34.0 + 2.0 * np.sin(x)
    phi = true.mean() + 0.5 * (true - true.mean())
    column, sd = SHARED.index("law_slope"), np.zeros(M)
    sd[column] = 1.0
    shared = np.zeros((60, M))
    shared[:, column] = phi - phi.mean()
    observation = Observed(phi, np.full(60, 0.05), shared, place)
    path = place[::6]
    anchors = [(Anchor(a, a, float(true[i]), 0.05), place[[i]]) for a, i in ((0.0, 0), (1.5, 30))]
    free, held = (
        pool(
            observation,
            Normal(np.zeros(M), np.diag(sd**2)),
            path,
            reference,
            torques=N,
            mean=32.0,
            mean_sd=8.0,
        )
        for reference in ([], anchors)
    )
    assert np.abs(free.path_phi - true[::6]).max() > 0.5
    assert held.path_phi == pytest.approx(true[::6], abs=0.1)
    far = np.abs(free.path_phi - free.path_phi.mean())
    assert free.path_relative_sd[far.argmax()] > 0.8 * far.max()


def test_what_is_learned_of_the_field_is_what_it_was_drawn_from() -> None:
    """Amplitude, length and the bed's scatter of a long walk, within what 240 places can settle.

    Fits are sharp and blunt in turn; the bed adds the same scatter to both.
    """
    rng = np.random.default_rng(0)
    place = np.column_stack([np.linspace(0.0, 40.0, 240), np.zeros(240)])
    sd, bed = np.tile([0.05, 0.6], 120), 0.25
    field = covariance(place, place, 2.0, 2.5, 8.0) + np.diag(sd**2 + bed**2)
    phi = 35.0 + np.linalg.cholesky(field - 8.0**2) @ rng.normal(size=240)
    observation = Observed(phi, sd, np.zeros((240, M)), place)
    pooled = pool(
        observation,
        Normal(np.zeros(M), np.eye(M)),
        place[:2],
        [],
        torques=N,
        mean=32.0,
        mean_sd=8.0,
    )
    assert pooled.field["length_m"] == pytest.approx(2.5, rel=0.3)
    assert pooled.field["amplitude_deg"] == pytest.approx(2.0, rel=0.3)
    assert pooled.sd == pytest.approx(np.hypot(sd, bed), rel=0.15)
    # Without the bed's it would be 0.43, with it it is 0.49.
    scatter = np.sqrt(np.mean(sd**2 + bed**2))
    assert pooled.field["scatter_deg"] == pytest.approx(scatter, rel=0.07)


def test_an_anchor_that_contradicts_is_told_from_one_that_agrees() -> None:
    observed, shared, path = problem()
    free = pool(observed, shared, path, [], torques=N, mean=32.0, mean_sd=8.0)
    there, sd = free.path_phi[0], free.path_absolute_sd[0]

    def surprise(*known: float) -> np.ndarray:
        anchors = [(Anchor(0.0, 0.5, phi, 0.2), path[i : i + 1]) for i, phi in enumerate(known)]
        return pool(observed, shared, path, anchors, torques=N, mean=32.0, mean_sd=8.0).surprise

    assert surprise(there).max() < 1e-6
    assert surprise(there + 3.0 * np.hypot(sd, 0.2)) == pytest.approx([3.0])
    assert surprise(there, there + 3.0).max() > 2.0  # neighbours


@pytest.mark.parametrize("text", ["x=0:0.5,phi=34±1", "x = 0.5 : 0, phi = 34 +- 1"])
def test_an_anchor_as_people_write_it(text: str) -> None:
    assert Anchor.of(text) == (0.0, 0.5, 34.0, 1.0, "x")
