"""``terraphi export`` and ``terraphi convert``: a module that works comes out, or a reason."""

from __future__ import annotations

import ast
import json
import math
import runpy
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.answer_file import Told, read
from terraphi.terrain.export import _quoted, export, in_plane_strain
from terraphi.terrain.simulators import NAMES, simulator


def answer(**changes: Any) -> dict[str, Any]:
    summary = {"median": 30.0, "ci68": [28.0, 32.0], "ci95": [26.0, 34.0]}
    return {
        "phi_deg": {**summary, "yield": "plane_strain"},
        "phi_plane_strain_deg": summary,
        "phi_plane_strain_reason": "",
        "verdict": "consistent",
        "reason": "It fits.",
        "density_kg_m3": 1600.0,
        "density_assumed": True,
        "source": "sand.csv",
        "library": "resolved",
        "provenance": {"library_hash": "of another"},
        **changes,
    }


def told(draws: Any = (), **changes: Any) -> Told:
    return Told("answer", answer(**changes), np.asarray(draws, dtype=float))


@pytest.fixture
def inverted(terraphi, tmp_path) -> Callable[..., None]:
    """Folder of an inversion, whose answer can be changed."""
    ran = terraphi("invert", "li2013:yuma/straight", "--library", "rft3d", "--out", "answer")
    assert ran.status == 0, ran.err

    def change(**changes: Any) -> None:
        with h5py.File(tmp_path / "answer" / "posterior.nc", "r+") as file:
            file.attrs["answer"] = json.dumps({**json.loads(file.attrs["answer"]), **changes})

    return change


@pytest.mark.parametrize("name", [name for name in NAMES if name != "mujoco"])
def test_the_module_sets_what_the_table_says(name, tmp_path, monkeypatch) -> None:
    to = simulator(name)
    found = export(told([25.0, 30.0, 35.0]), to, draws=3)
    path = tmp_path / "soil.py"
    path.write_text(found.text("python"), encoding="utf-8")
    made = runpy.run_path(str(path))
    value = to.from_angle(30.0)
    assert made[to.parameter.upper()] == pytest.approx(value, abs=1e-6)
    assert sorted(made["DRAWS"]) == pytest.approx([to.from_angle(p) for p in (25.0, 30.0, 35.0)])
    assert made["DENSITY"] == 1600.0
    assert made["LEG_FRICTION"] is None  # the library at hand is another
    assert "plane strain" in made["__doc__"]
    assert to.left_alone in made["__doc__"]
    assert set_by(name, made, monkeypatch) == pytest.approx(value, abs=1e-6)


def set_by(name: str, made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> float:
    """What the module hands to the simulator's own interface."""
    if name == "genesis":
        sand = SimpleNamespace(Sand=lambda **given: given)
        genesis = SimpleNamespace(materials=SimpleNamespace(MPM=sand))
        monkeypatch.setitem(sys.modules, "genesis", genesis)
        return made["sand"](E=1e6)["friction_angle"]
    if name in ("newton", "isaaclab"):
        kept = np.zeros(3)
        field = SimpleNamespace(numpy=lambda: kept, assign=lambda new: np.copyto(kept, new))
        made["set_friction"](SimpleNamespace(mpm=SimpleNamespace(friction=field)), particles=[0, 2])
        assert kept[1] == 0.0
        return kept[2]
    if name == "chrono-crm":
        properties = made["fill"](SimpleNamespace())
        assert properties.mu_fric_2 == properties.mu_fric_s
        return properties.mu_fric_s
    if name == "chrono-scm":
        given: list[float] = []
        terrain = SimpleNamespace(SetSoilParameters=lambda *all_: given.extend(all_))
        made["set_soil"](terrain, 1e6, 1.1, 0.01, 1e8, 3e4)
        return given[4]
    assert made["material"](1e7, 0.3)["dpType"] == "MiddleCircumscribed"
    return made["material"](1e7, 0.3)["Friction"]


@pytest.mark.parametrize(
    "text",
    [
        'x"""\nimport sys\nsys.stolen = True\n"""',
        "C:\\new\\u00\\N{x}\\",
        'a"" "b" \\"""',
        "nul\0 \ud800 \u2028",
    ],
)
def test_what_others_wrote_stays_a_text(text, tmp_path) -> None:
    changes = {"source": text, "library": text, "verdict": "misfit", "reason": text}
    found = export(told(**changes)._replace(source=text), simulator("newton"), anyway=True)
    tree = ast.parse(found.text("python"))
    clean = ast.parse(export(told(), simulator("newton")).text("python"))
    kinds = [[type(node) for node in one.body] for one in (tree, clean)]
    assert kinds[0] == kinds[1]
    assert f"From {text}: {text}, library {text}." in (ast.get_docstring(tree, clean=False) or "")


def test_a_quotation_mark_at_the_end_ends_no_docstring() -> None:
    text = 'he said "so"'
    assert ast.literal_eval(f'"""{_quoted(text)}"""') == text


def test_the_json_of_an_inversion_is_enough() -> None:
    """With the keys that 'terraphi invert --json' promises, and no others."""
    summary = {"median": 30.0, "ci68": [28.0, 32.0], "ci95": [26.0, 34.0]}
    promised = {
        "phi_deg": {**summary, "yield": "plane_strain"},
        "phi_plane_strain_deg": summary,
        "verdict": "consistent",
        "reason": "It fits.",
        "edge": None,
        "nrmsd": {"Fx": 0.1, "Fz": 0.1},
        "density_kg_m3": 1600.0,
        "n_angles": 40,
        "library": "resolved",
        "sampler": "quadrature",
        "convergence": {},
    }
    found = export(Told("answer", promised, np.empty(0)), simulator("newton"))
    assert (found.density, found.assumed) == (1600.0, True)
    assert "DENSITY [kg/m³] was assumed." in found.text("python")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"phi_plane_strain_deg": {}}, "has no 'ci95'"),
        ({"phi_plane_strain_deg": {"median": 30.0, "ci95": [1.0, 2.0]}}, "has no 'ci68'"),
        ({"phi_deg": 30.0, "phi_plane_strain_deg": 30.0}, "not as 'terraphi invert' writes"),
        ({"density_kg_m3": "heavy"}, "heavy"),
        ({"density_kg_m3": None}, "has no 'parameters'"),
    ],
)
def test_an_answer_that_lacks_something_is_told(changes, words) -> None:
    with pytest.raises(InputError, match=words) as caught:
        export(told(**changes), simulator("newton"))
    assert str(caught.value).startswith("answer: ")


def test_draws_of_other_conventions_are_turned_into_plane_strain() -> None:
    # sin φ' = 2 sin φ / (√3 (3 - sin φ)), docs/explanation/friction-angle.md
    sines = [math.sin(math.radians(phi)) for phi in (30.0, 35.0, 40.0)]
    turned = [math.degrees(math.asin(2 * s / (math.sqrt(3) * (3 - s)))) for s in sines]
    summary = {"median": turned[1], "ci68": turned[::2], "ci95": turned[::2]}
    phi = {"median": 35.0, "ci68": [30.0, 40.0], "ci95": [30.0, 40.0], "yield": "paper"}
    one = told([30.0, 35.0, 40.0], phi_deg=phi, phi_plane_strain_deg=summary)
    assert in_plane_strain(one) == pytest.approx(turned)
    other = {**summary, "median": 20.0}
    with pytest.raises(InputError, match="leave out --draws"):
        in_plane_strain(told([30.0], phi_deg=phi, phi_plane_strain_deg=other))
    # A triaxial angle beyond 42.2 deg has none; the others do.
    triaxial = {**phi, "median": 30.0, "yield": "triaxial"}
    wanted = {**summary, "median": math.degrees(math.asin(3 * 2 * 0.5 / (math.sqrt(3) * 2.5)))}
    one = told([30.0, 44.0], phi_deg=triaxial, phi_plane_strain_deg=wanted)
    found = export(one, simulator("newton"), draws=2)
    assert found.left_out == 0.5
    assert found.draws == pytest.approx([2 * 3 * 0.5 / (math.sqrt(3) * 2.5)] * 2, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"verdict": "misfit", "reason": "No angle fits."}, "misfit: No angle fits. Export it all"),
        ({"verdict": "out_of_range", "reason": "At 50."}, "out of range: At 50."),
        ({"phi_deg": None}, "was not inferred"),
        ({"phi_plane_strain_deg": None, "phi_plane_strain_reason": "too strong"}, "too strong"),
    ],
)
def test_what_nobody_should_simulate_is_refused(changes, words) -> None:
    with pytest.raises(InputError, match=words):
        export(told(**changes), simulator("newton"))


def test_anyway_is_said_at_the_top() -> None:
    found = export(
        told(verdict="misfit", reason="No angle fits."), simulator("newton"), anyway=True
    )
    first, _, second = found.text("python").splitlines()[:3]
    assert first.startswith('"""Soil for Newton')
    assert second == "CAUTION: the verdict is misfit: No angle fits."


def test_what_a_consistent_answer_asks_is_said_at_the_top() -> None:
    found = export(told(warnings=["The density is assumed.", "Is it in N?"]), simulator("newton"))
    said = "CAUTION: The density is assumed. Is it in N?"
    assert found.text("python").splitlines()[2] == said
    assert found.headline().endswith(said)
    assert found.as_dict()["caution"] in said


def test_from_the_folder_of_an_inversion(terraphi, inverted, tmp_path) -> None:
    base = ("export", "answer", "--to", "newton")
    refused = terraphi(*base, "--out", "soil.py")
    assert refused.status == 2
    assert "not of a yield criterion" in refused.err
    assert not (tmp_path / "soil.py").exists()
    phi = read(tmp_path / "answer").answer["phi_deg"]
    inverted(phi_deg={**phi, "yield": "plane_strain"}, phi_plane_strain_deg=phi, verdict="misfit")
    assert "with --anyway" in terraphi(*base).err
    drawn = ("--anyway", "--draws", "5", "--seed", "1")
    ran = terraphi(*base, *drawn, "--out", "soil.py")
    assert ran.status == 0, ran.err
    made = runpy.run_path(str(tmp_path / "soil.py"))
    assert len(made["DRAWS"]) == 5
    assert made["LEG_FRICTION"] == 0.4  # rft3d's
    printed = json.loads(terraphi(*base, *drawn, "--json").out)
    assert printed["draws"] == made["DRAWS"]
    assert printed["value"] == pytest.approx(math.sin(math.radians(phi["median"])), abs=1e-6)
    assert terraphi(*base, "--anyway", "--out", "soil.usda").status == 0
    assert "newton:mpm:internalFriction" in (tmp_path / "soil.usda").read_text()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("no", "--to", "newton"), "no: no such file"),
        (("bad.json", "--to", "newton"), "bad.json: not an answer of 'terraphi invert"),
        (("bad.nc", "--to", "newton"), "bad.nc: not an answer of 'terraphi invert"),
        (("answer.json", "--to", "nwton"), "did you mean 'newton'"),
        (("answer.json", "--to", "mujoco"), "mujoco has no soil"),
        (("answer.json", "--to", "newton", "--draws", "3"), "has no draws of the posterior"),
        (("answer.json", "--to", "newton", "--out", "soil.txt"), "name a .py, .json or .usda"),
        (("answer.json", "--to", "genesis", "--out", "soil.usda"), "reads no materials in USD"),
        (("answer.json", "--to", "newton", "--out", "mine.py"), "is there, and not written by"),
    ],
)
def test_what_cannot_be_exported(terraphi, tmp_path, args, words) -> None:
    (tmp_path / "answer.json").write_text(json.dumps(answer()))
    for name in ("bad.json", "bad.nc", "mine.py"):
        (tmp_path / name).write_text("[1]")
    before = sorted(tmp_path.iterdir())
    ran = terraphi("export", *args)
    assert (ran.status, ran.out) == (2, "")
    assert words in ran.err
    assert ran.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_convert(terraphi) -> None:
    ran = terraphi("convert", "0.68", "--from", "newton", "--to", "genesis")
    assert "42.8 deg" in ran.out
    assert "29.5 deg" in ran.out
    told_ = json.loads(terraphi("convert", "0.68", "--from", "newton", "--json").out)
    assert told_["phi_plane_strain_deg"] == pytest.approx(42.8, abs=0.05)
