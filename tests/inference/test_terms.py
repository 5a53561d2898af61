"""Each term of an interval against the scatter of angles when its cause is drawn.

A term that is too wide is as wrong as one that is too narrow: both ways by 15 %. Causes are drawn
by the quantiles of the normal distribution in random order.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

import terraphi
from terraphi.experiment.priors import CONTACT_SD_M, CONTACT_SD_PART, FRICTION
from terraphi.experiment.rig import Rig
from terraphi.inference.answer import Answer
from terraphi.inference.combined import errors_of
from terraphi.inference.likelihood import RIDGE, Likelihood
from terraphi.inference.pressed import (
    COMPACTING_DEG,
    CONTRACTIONS,
    EXPONENTS,
    PRIOR,
    SHAPE_LENGTH,
    SHAPE_SD,
    SIGNIFICANT,
)
from terraphi.inference.records import open_record
from terraphi.inference.terms import TERMS, Term
from terraphi.laws.foot import LAWS, Foot
from terraphi.laws.legs import shipped_legs

DRAWS = 200
QUANTILES = norm.ppf((np.arange(DRAWS) + 0.5) / DRAWS)
GRAINS = Path(__file__).parents[2] / "studies" / "data" / "grains"


def quantiles(rng: np.random.Generator, count: int = 1) -> np.ndarray:
    """Standard normal numbers [draw, count], uncorrelated and with a variance of 1 as they are."""
    draws = np.stack([rng.permutation(QUANTILES) for _ in range(count)], axis=1)
    lower = np.linalg.cholesky(np.atleast_2d(np.cov(draws.T, bias=True)))
    return draws @ np.linalg.inv(lower).T


class Legs:
    """Two records of a leg in one soil, as law ``legs`` has them, and angles of drawn ones.

    The angles are those of least squares over φ and a shift of each record, at the cohesion that
    the answer has, by Newton's method with slopes of the undisturbed forces.
    """

    def __init__(self, leg: str, phi_deg: float) -> None:
        self.rig = Rig.of({
            "leg": leg, "length_mm": 80.0, "width_mm": 27.0, "thickness_mm": 6.4,
            "hip_height_mm": "20±1.2", "leg_friction": 0.35, "leg_friction_sd": 0.05,
        })  # fmt: skip
        self.law, self.phi_deg = shipped_legs(), phi_deg
        self.error = self.law.error
        curve = self.law.forces(self.rig, float(self.read(np.array(phi_deg))), density=1600.0)
        theta = np.arange(-85.0, 85.1, 0.5)
        force = [np.interp(theta, curve.theta_deg, row) for row in curve.forces.values[0]]
        table = pd.DataFrame({"theta_deg": theta, "Fx_N": force[0], "Fz_N": force[1]})
        record = open_record(table, rig=self.rig, density="1600±80", gain="1±0.03", noise=4.0)
        self.records = [replace(record, source=name) for name in ("first", "second")]
        self.likelihood = Likelihood(self.records, self.law)
        number = self.likelihood.cohesion / (1600.0 * 9.81 * self.rig.length)
        self.number = float(number)
        self.phi = self.likelihood.least_squares
        self.data = self.means(self.rig, np.full(1, self.phi), np.zeros((1, 2)))
        step = 0.05
        moved = [
            self.means(self.rig, self.phi + a * np.ones(1), b[None])
            for a, b in (
                (step, np.zeros(2)),
                (0.0, step * np.eye(2)[0]),
                (0.0, step * np.eye(2)[1]),
            )
        ]
        slope = np.vstack([(item - self.data) / step for item in moved]).T
        span = np.repeat(np.concatenate([record.span] * 2), record.theta_deg.size)
        self.span = span
        self.weights = np.linalg.pinv(slope / span[:, None]) / span

    def read(self, phi_deg: np.ndarray) -> np.ndarray:
        """What the law reads off a soil [deg]."""
        return phi_deg + self.error.offset(self.rig, 0.0, phi_deg)

    def means(self, rig: Rig, phi: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Window means of both records [draw, n] at angles [draw] and further shifts [draw, 2]."""
        law, rows = self.law.law(rig), []
        forces = 1600.0 / law.density * law(self.read(phi)[:, None], self.number)
        base = self.likelihood.shift_deg
        for force, shifts in zip(forces, shift + base, strict=True):
            each = [
                (force @ record.operator(law.theta_deg + item).T).ravel()
                for record, item in zip(self.records, shifts, strict=True)
            ]
            rows.append(np.concatenate(each))
        return np.array(rows)

    def angles(self, data: np.ndarray) -> np.ndarray:
        """φ of drawn data, shape [draw, n] -> [draw]."""
        x = np.zeros((len(data), 3))
        for _ in range(4):
            x += (data - self.means(self.rig, self.phi + x[:, 0], x[:, 1:])) @ self.weights.T
        return x[:, 0]

    # -- causes: data of 200 draws, shape [draw, n] ------------------------------------------------

    def scaled(self, rng: np.random.Generator, sd: float) -> np.ndarray:
        return self.data * (1.0 + sd * quantiles(rng))

    def turned(self, sizes: np.ndarray) -> np.ndarray:
        """Of soil that reads otherwise by some angles [draw]."""
        return self.means(self.rig, self.phi + sizes, np.zeros((DRAWS, 2)))

    def of_rig(self, rng: np.random.Generator, name: str, sd: float) -> np.ndarray:
        """Of a rig of another size, by a parabola through three sizes."""
        nodes = np.array([-1.5, 0.0, 1.5]) * sd
        curves = [
            self.means(
                self.rig.model_copy(update={name: getattr(self.rig, name) + node}),
                np.full(1, self.phi), np.zeros((1, 2)),
            )[0]
            for node in nodes
        ]  # fmt: skip
        return np.polynomial.polynomial.polyval(
            sd * quantiles(rng)[:, 0], np.polynomial.polynomial.polyfit(nodes, curves, 2)
        ).T

    def noisy(self, rng: np.random.Generator) -> np.ndarray:
        """Of readings that scatter, and of a law whose window means are off."""
        record, rows = self.records[0], []
        count = len(record.history.position)
        for _ in range(DRAWS):
            noise = rng.normal(0.0, np.array(record.noise)[:, None], (2, 2, count))
            rows.append(np.concatenate([record.means(row) for row in noise.reshape(4, count)]))
        return self.data + rows + RIDGE * self.span * rng.standard_normal((DRAWS, self.span.size))

    def interpolated(self, rng: np.random.Generator) -> np.ndarray:
        """Of a law whose Gaussian process is off, by the same on both records."""
        law = self.law.law(self.rig)
        x, depth, forces = law._at(self.read(np.array([self.phi])), self.number)
        errors = 1600.0 / law.density * forces(self.law.errors(x, depth))[:, 0]
        each = np.array([
            np.concatenate([
                (error @ record.operator(law.theta_deg + shift).T).ravel()
                for record, shift in zip(self.records, self.likelihood.shift_deg, strict=True)
            ])
            for error in errors
        ])  # fmt: skip
        return self.data + quantiles(rng, len(each)) @ each


def offset(world: Legs, rng: np.random.Generator) -> np.ndarray:
    """Errors of effects that are known together."""
    root = np.linalg.cholesky(np.array(world.error.covariance_deg2) + 1e-9 * np.eye(10))
    read_deg = float(world.read(np.array(world.phi)))
    row = world.error.row(world.rig, 0.0, read_deg)
    return world.turned(row @ root @ quantiles(rng, 10).T)


def bed(world: Legs, rng: np.random.Generator) -> np.ndarray:
    """Beds of both records, each by itself."""
    sd, half = world.error.bed_sd(world.rig, 0.0), world.data.shape[-1] // 2
    first, second = (world.turned(sd * q) for q in quantiles(rng, 2).T)
    return np.hstack([first[:, :half], second[:, half:]])


OF_LEGS: dict[str, Callable[[Legs, np.random.Generator], np.ndarray]] = {
    "noise": Legs.noisy,
    "emulator": Legs.interpolated,
    "density": lambda world, rng: world.scaled(rng, 0.05),
    "gain": lambda world, rng: world.scaled(rng, 0.03),
    "hip height": lambda world, rng: world.of_rig(rng, "hip_height_mm", 1.2),
    "leg friction": lambda world, rng: world.of_rig(rng, "leg_friction", 0.05),
    "model: offset": offset,
    "model: soil": lambda w, rng: w.turned(w.error.soil_sd_deg * quantiles(rng)[:, 0]),
    "model: leg": lambda w, rng: w.turned(w.error.leg_sd_deg * quantiles(rng)[:, 0]),
    "model: bed": bed,
    "model: rig": lambda w, rng: w.turned(w.error.rig_sd_deg * quantiles(rng)[:, 0]),
}


@pytest.mark.parametrize(("leg", "phi_deg"), [("straight", 38.0), ("c", 30.0)])
def test_terms_of_legs_are_the_scatter_of_angles_when_their_causes_are_drawn(
    leg: str, phi_deg: float
) -> None:
    world, rng = Legs(leg, phi_deg), np.random.default_rng(0)
    budget = world.likelihood.budget()
    assert set(budget) <= set(OF_LEGS)
    scatter = {
        name: float(np.std(world.angles(draw(world, rng)))) for name, draw in OF_LEGS.items()
    }
    stated = {name: budget.get(name, 0.0) for name in OF_LEGS}
    assert scatter == pytest.approx(stated, rel=0.15, abs=0.01)


SHARED_BY: dict[str, str] = {
    "density": "soil", "model: soil": "soil", "cohesion": "soil",
    "gain": "law", "leg friction": "law", "model: law": "law",
    "model: compaction": "law", "surface friction": "law", "rectangle": "law",
    "model: offset": "cause", "model: leg": "shape", "model: rig": "record",
    "model: bed": "record", "grain size": "record",
    "hip height": "law", "emulator": "record", "noise": "record",
    "model: course": "record", "contact": "record", "contraction": "record", "depth": "record",
    "missing angles": "record", "missing forces": "record", "second opinion": "record",
}  # fmt: skip
"""Which answers of a joint one are off by the same cause: of one soil, law, or shape of leg."""


@pytest.fixture(scope="module")
def bodies() -> tuple[Answer, list[Answer]]:
    """Two straight legs, a C and two tools in one soil: the joint answer, and each by itself."""
    long = {"leg": "straight", "length_mm": 110, "width_mm": 40, "thickness_mm": 8,
            "hip_height_mm": "35±1"}  # fmt: skip
    shapes = {"straight": "straight", "rig-long": long, "c": "c", "disc_60": "plate:60",
              "ball_44": "ball:44"}  # fmt: skip
    sources = [(GRAINS / f"B-loose_{name}_1.csv", body) for name, body in shapes.items()]
    given = {"density": "1415±60", "leg": "straight", "rig": "li2013", "grain_size_mm": 6.0}
    alone = [terraphi.invert(source, **given) for source in sources[:3]]
    of_soil = {"density": "1415±60", "grain_size_mm": 6.0}
    alone += [terraphi.invert(source, **of_soil) for source in sources[3:]]
    return terraphi.invert(sources, **given), alone


def shifts(alone: Sequence[Answer], name: str, rng: np.random.Generator) -> np.ndarray:
    """Errors of each answer by one term [deg], its causes drawn, shape [draw, answer]."""
    if SHARED_BY[name] == "cause":
        causes = [np.array(answer.offset_causes_deg or np.zeros(10)) for answer in alone]
        return quantiles(rng, 10) @ np.array(causes).T
    keys = {
        "soil": [0] * len(alone), "law": [answer.law for answer in alone],
        "shape": ["straight", "straight", "c", "plate", "ball"], "record": range(len(alone)),
    }  # fmt: skip
    groups = [str(key) for key in keys[SHARED_BY[name]]]
    draws = quantiles(rng, len(groups))
    sizes = np.array([answer.budget_deg.get(name, 0.0) for answer in alone])
    return draws[:, [groups.index(key) for key in groups]] * sizes


def test_terms_of_a_joint_answer_are_its_scatter_when_their_causes_are_drawn(
    bodies: tuple[Answer, list[Answer]],
) -> None:
    """What answers share is drawn once."""
    joint, alone = bodies
    weight = {each["source"]: each["weight"] for each in joint.provenance["answers"]}
    w = np.array([weight[answer.source] for answer in alone])
    assert joint.phi.median == pytest.approx(w @ [answer.phi.median for answer in alone], abs=0.05)
    rng = np.random.default_rng(1)
    for name, stated in joint.budget_deg.items():
        if name != "disagreement":
            scatter = np.std(shifts(alone, name, rng) @ w)
            assert scatter == pytest.approx(stated, rel=0.15, abs=0.01), name


def test_answers_are_correlated_as_draws_of_their_causes_are(
    bodies: tuple[Answer, list[Answer]],
) -> None:
    """Sum of the drawn errors of all terms; moisture is each answer's own in the weights."""
    _, alone = bodies
    names, rng = [*SHARED_BY], np.random.default_rng(2)
    errors = errors_of(alone, names)
    drawn = sum(
        np.cov(shifts(alone, name, rng).T, bias=True) for name in names if name != "cohesion"
    )
    drawn += np.diag(np.square(errors.sds[names.index("cohesion")]))
    sd = np.sqrt(np.diag(drawn))
    # The intervals of tools are no normal distributions, so that their terms miss some 2 % of them.
    np.testing.assert_allclose(
        errors.covariance / np.outer(sd, sd), drawn / np.outer(sd, sd), atol=0.05
    )


@pytest.mark.parametrize("key", ["record", "soil", "law"])
def test_a_term_is_added_in_one_place(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of the table and a size: it is in the budget, in the JSON and in the joint answer."""
    sizes = Likelihood._angle_sds

    def with_temperature(self: Likelihood) -> dict[str, np.ndarray]:
        return sizes(self) | {"temperature": np.full(len(self.records), 2.0)}

    monkeypatch.setattr(Likelihood, "_angle_sds", with_temperature)
    with pytest.raises(LookupError, match="'temperature'"):
        terraphi.invert("li2013:yuma/straight")
    monkeypatch.setitem(TERMS, "temperature", Term("given", key))
    alone = [terraphi.invert(f"li2013:yuma/{leg}") for leg in ("straight", "c")]
    joint = terraphi.invert([f"li2013:yuma/{leg}" for leg in ("straight", "c")])
    for answer in alone:
        assert answer.budget_deg["temperature"] == pytest.approx(2.0, rel=0.01)
        assert answer.as_dict()["budget_deg"]["temperature"] == answer.budget_deg["temperature"]
    weights = [each["weight"] for each in joint.provenance["answers"]]
    # Weights add up to 1, so that an error of both answers stays, and one of each gets less.
    expected = 2.0 * np.hypot(*weights) if key == "record" else 2.0
    assert joint.budget_deg["temperature"] == pytest.approx(expected, rel=0.01)


class Pressed:
    """A body that is pressed into soil as law ``foot`` has it."""

    def __init__(self, tool: str, phi_deg: float) -> None:
        self.tool, self.phi_deg = tool, phi_deg
        shape, size_mm = tool.split(":")
        self.foot = Foot(5e-4 * float(size_mm), "disc" if shape == "plate" else "ball")
        self.z = np.linspace(5e-4, 1.5 * self.foot.radius, 120)
        near = np.exp(-np.abs(np.log(self.z[:, None] / self.z)) / SHAPE_LENGTH)
        self.course = SHAPE_SD * np.linalg.cholesky(near + 1e-12 * np.eye(self.z.size))

    def answer(
        self, *, density: float = 1500.0, friction: float = FRICTION.mean, contact: float = 0.0,
        share: np.ndarray | float = 1.0,
    ) -> Answer:  # fmt: skip
        """Of forces times a share at each depth, read at a density of 1500 kg/m³."""
        force = LAWS["foot"].force(
            self.foot, self.z + contact, 0.5 * np.pi, friction_angle_deg=self.phi_deg,
            density=density, surface_friction=friction,
        )[..., 1]  # fmt: skip
        table = pd.DataFrame({"sinkage_mm": 1e3 * self.z, "force_N": share * force})
        return terraphi.invert(table, tool=self.tool, density="1500±75")

    def scatter(self, **draws: Sequence[Any]) -> float:
        """Of the angles when one of what the answer assumes is drawn."""
        [(name, values)] = draws.items()
        return float(np.std([self.answer(**{name: value}).phi.median for value in values]))


@pytest.mark.parametrize(("tool", "phi_deg"), [("plate:60", 26.0), ("ball:60", 31.0)])
def test_terms_of_tools_are_the_scatter_of_angles_when_their_causes_are_drawn(
    tool: str, phi_deg: float
) -> None:
    world = Pressed(tool, phi_deg)
    budget = world.answer().budget_deg
    z = norm.ppf((np.arange(9) + 0.5) / 9)
    z /= z.std()
    # Ten modes have 93 % of the variance of a course; each moves the angle by itself.
    modes, sizes, _ = np.linalg.svd(world.course)
    courses = (modes * sizes)[:, :10].T
    courses *= np.linalg.norm(sizes) / np.linalg.norm(sizes[:10])
    scatter = {
        "density": world.scatter(density=1500.0 + 75.0 * z),
        "model: course": np.sqrt(10.0) * world.scatter(share=1.0 + np.vstack([courses, -courses])),
        # Half of the error, for the law ends at 0.65.
        "surface friction": 2.0 * world.scatter(friction=FRICTION.mean + 0.5 * FRICTION.sd * z),
    }
    for name, sd in scatter.items():
        assert sd == pytest.approx(budget[name], rel=0.15), name
    # A plate bears at once where it touches, so that its angle is not linear in the contact.
    z = norm.ppf((np.arange(15) + 0.5) / 15)
    z /= z.std()
    contact = world.scatter(contact=max(CONTACT_SD_M, CONTACT_SD_PART * world.foot.radius) * z)
    assert contact == pytest.approx(budget.get("contact", 0.0), abs=0.1)
    # The soil's part of the law's error counts once.
    model = np.hypot(budget["model: soil"], budget["model: law"])
    assert model == pytest.approx(LAWS["foot"].sd_deg)


@pytest.mark.slow
def test_the_contraction_of_soils_drawn_from_its_prior_is_as_uncertain_as_stated() -> None:
    """Loose soils that compact by an exponential share, with the law's course off as well."""
    world, rng = Pressed("plate:60", 30.0), np.random.default_rng(0)
    errors, stated = [], []
    for course in 1.0 + rng.standard_normal((200, world.z.size)) @ world.course.T:
        lacking = min(rng.exponential(PRIOR), CONTRACTIONS[-1])
        decay = rng.choice(EXPONENTS) * world.foot.radius
        answer = world.answer(share=course * (1.0 - lacking * np.exp(-world.z / decay)))
        # Of two angles, which compacting soil and other soil have, the mean is unbiased.
        grid, density = answer.grid_deg, answer.density
        truth = 30.0 + COMPACTING_DEG * (lacking >= SIGNIFICANT)
        errors.append(np.trapezoid(grid * density, grid) - truth)
        stated.append([answer.budget_deg[name] for name in ("contraction", "model: course")])
    variance = np.square(stated).sum(axis=1)
    assert np.mean(np.square(errors)) == pytest.approx(np.mean(variance), rel=0.3)  # 15 % of an SD


def test_names_of_terms_in_tests_are_in_the_table() -> None:
    assert {*OF_LEGS} | {*SHARED_BY} <= TERMS.keys()


def test_the_page_of_the_interval_explains_each_name_that_is_printed() -> None:
    page = Path(__file__).parents[2].joinpath("docs", "explanation", "interval.md")
    lines = re.findall(r"^- \*\*(.+?)\*\*: \w", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert not TERMS.keys() - {name for line in lines for name in line.split(", ")}
