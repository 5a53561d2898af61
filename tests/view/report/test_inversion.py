"""The report of an inversion against what the inversion found."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement
from terraphi.inference.answer import PHI, Inversion
from terraphi.inference.inversion import invert
from terraphi.library.store import Library
from terraphi.view.report.inversion import (
    CONVENTION,
    NO_BAND,
    OTHER_LIKELIHOOD,
    UNCHECKED,
    UNKNOWN,
    _belief,
    _density,
    headline,
    library_of,
    load,
    section,
)
from terraphi.view.report.page import context, render
from terraphi.view.report.parts import Plot, Section, Text
from terraphi.view.table import Table

HOSTILE = "</script><img src=x onerror=alert(1)><b>'\"&$x$"


def plots(found: Section) -> dict[str, Plot]:
    return {part.title.split(":")[0]: part for part in found.parts if isinstance(part, Plot)}


def test_headline_has_angle_convention_intervals_and_verdict(inversion: Inversion) -> None:
    text = headline(inversion.as_dict())
    assert f"φ = {inversion.phi.median:{inversion.digits(PHI)}}°" in text
    assert CONVENTION[inversion.convention] in text
    assert f"68 %: {inversion.span(PHI, inversion.phi.ci68)}°" in text
    assert f"95 %: {inversion.span(PHI, inversion.phi.ci95)}°" in text
    assert inversion.verdict.verdict.replace("_", " ") in text


def test_headline_names_the_equivalent_in_plane_strain(inversion: Inversion) -> None:
    answer = inversion.as_dict()
    answer["phi_deg"]["yield"] = "paper"
    answer["phi_plane_strain_deg"] = {"median": 17.37, "ci68": [16, 18], "ci95": [15, 19]}
    assert "which acts as 17° in plane strain" in headline(answer)


def test_a_narrow_interval_has_two_ends(inversion_folder: Path, tmp_path: Path) -> None:
    answer = json.loads((inversion_folder / "answer.json").read_text())
    narrow = {"median": 31.003, "ci68": [31.0001, 31.0061], "ci95": [30.997, 31.009]}
    for told in (answer["phi_deg"], answer["parameters"]["soil.friction_angle_deg"]):
        told |= narrow
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    found = section(tmp_path)
    assert "φ = 31.003°" in found.headline
    assert "68 %: 31.000 to 31.006°, 95 %: 30.997 to 31.009°" in found.headline
    assert found.overview["68 %"] == "31.000 to 31.006°"
    numbers = next(p for p in found.parts if p.title == "In numbers")
    assert isinstance(numbers, Table)
    assert numbers.rows[0][1:] == ("31.003", "31.000 to 31.006", "30.997 to 31.009")


def test_the_ends_of_the_library_that_are_drawn_are_named(
    inversion: Inversion, inversion_folder: Path
) -> None:
    saved = load(inversion_folder)
    again = library_of(saved.answer, None)
    for ends, words in (
        ([10.0, 60.0], " Dashed: the library ends at 15° and 50°."),
        ([16.0, 60.0], " Dashed: the library ends at 15° and 50°."),
        ([27.0, 48.0], " Dashed: the library ends at 50°."),
        ([28.0, 32.0], ""),
    ):
        phi = {**saved.answer["phi_deg"], "ci68": ends, "ci95": ends}
        plot = _density(replace(saved, answer={**saved.answer, "phi_deg": phi}), again)
        assert plot.note.startswith(f"Line: median.{words} Smoothed")
        assert sum(s["line"]["dash"] == "dash" for s in plot.layout["shapes"]) == words.count("°")


def test_curves_are_those_of_the_inversion(inversion: Inversion, inversion_folder: Path) -> None:
    found = plots(section(inversion_folder))
    assert not [plot.title for plot in found.values() if "misfit" in plot.title]
    assert found["Fx"].title.startswith("Fx: deviation ")
    half = len(inversion.record.observation.theta_deg)
    for name, part in (("Fx", slice(0, half)), ("Fz", slice(half, None))):
        band, best, measured = found[name].traces
        np.testing.assert_allclose(measured["x"], inversion.record.observation.theta_deg, rtol=1e-4)
        np.testing.assert_allclose(
            measured["y"], inversion.record.observation.vector[part], rtol=1e-4, atol=1e-6
        )
        np.testing.assert_allclose(best["y"], inversion.record.best[part], rtol=1e-4, atol=1e-6)
        top, floor = np.array(band["y"]).reshape(2, -1)
        np.testing.assert_allclose(top, inversion.record.band[1, part], rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(
            floor[::-1], inversion.record.band[0, part], rtol=1e-3, atol=1e-5
        )


def test_residuals_are_data_minus_best(inversion: Inversion, inversion_folder: Path) -> None:
    traces = plots(section(inversion_folder))["Residuals"].traces
    rest = (inversion.record.observation.vector - inversion.record.best).reshape(2, -1)
    spans = [np.ptp(inversion.record.observation.Fx), np.ptp(inversion.record.observation.Fz)]
    for trace, residual, span in zip(traces, rest, spans, strict=True):
        np.testing.assert_allclose(trace["customdata"], residual, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(trace["y"], 100.0 * residual / span, rtol=1e-3, atol=1e-4)


def test_density_holds_the_mass_of_its_intervals(
    inversion: Inversion, inversion_folder: Path
) -> None:
    density, band95, band68, *_ = plots(section(inversion_folder))[
        "Posterior of the friction angle"
    ].traces
    x, y = np.array(density["x"]), np.array(density["y"])
    for ends, expected in ((inversion.phi.ci68, 0.68), (inversion.phi.ci95, 0.95)):
        inside = np.linspace(*ends, 2001)
        height = np.interp(inside, x, y)
        mass = float(np.sum(0.5 * np.diff(inside) * (height[1:] + height[:-1])))
        assert mass == pytest.approx(expected, abs=0.03)
    assert "95 %" in band95["name"]
    assert "68 %" in band68["name"]


def test_information_sums_to_the_whole(inversion_folder: Path) -> None:
    fx, fz, total = plots(section(inversion_folder))["Which angles told the friction angle"].traces
    assert sum(fx["y"]) + sum(fz["y"]) == pytest.approx(100.0, abs=0.01)
    assert total["y"][-1] == pytest.approx(100.0, abs=0.01)


def test_an_answer_without_its_posterior_is_still_told(
    inversion_folder: Path, tmp_path: Path
) -> None:
    shutil.copy(inversion_folder / "answer.json", tmp_path)
    found = section(tmp_path / "answer.json")
    assert found.headline == section(inversion_folder).headline
    assert not plots(found)
    assert any(isinstance(part, Table) for part in found.parts)


def test_posterior_alone_will_do(inversion_folder: Path, tmp_path: Path) -> None:
    shutil.copy(inversion_folder / "posterior.nc", tmp_path / "other.nc")
    assert section(tmp_path / "other.nc").headline == section(inversion_folder).headline


def test_a_library_is_never_a_path_out_of_a_file(inversion_folder: Path) -> None:
    answer = {**load(inversion_folder).answer, "library": "../../gone"}
    assert library_of(answer, None) is None
    wrong = {**answer, "library": "rft3d", "provenance": {"library_hash": "another"}}
    assert library_of(wrong, None) is None


def test_another_library_is_refused(inversion_folder: Path) -> None:
    with pytest.raises(InputError, match="not the one that was used"):
        section(inversion_folder, library="quick-paper")


def test_hostile_answer_is_only_text(inversion_folder: Path, tmp_path: Path) -> None:
    answer = json.loads((inversion_folder / "answer.json").read_text())
    answer |= {"source": HOSTILE, "reason": HOSTILE, "library": HOSTILE, "verdict": HOSTILE}
    answer["phi_deg"]["yield"] = HOSTILE
    answer["convergence"] = {HOSTILE: HOSTILE}
    answer["provenance"] = {HOSTILE: [HOSTILE]}
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    html = render([section(tmp_path)])
    assert "<img" not in html
    assert html.count("</script>") == 3


@pytest.mark.parametrize(
    "broken",
    ["", "[]", "{}", '{"phi_deg": 1}', '{"phi_deg": {"median": NaN}}', "\x00\x01"],
)
def test_what_is_no_answer_is_refused_in_a_sentence(broken: str, tmp_path: Path) -> None:
    (tmp_path / "answer.json").write_text(broken)
    with pytest.raises(InputError, match=r"answer\.json: not an answer"):
        section(tmp_path)


def test_a_broken_posterior_is_refused(inversion_folder: Path, tmp_path: Path) -> None:
    whole = (inversion_folder / "posterior.nc").read_bytes()
    (tmp_path / "posterior.nc").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="not a whole posterior"):
        section(tmp_path)


def test_nobody_is_told_to_believe_a_library_that_nobody_checked(
    inversion_folder: Path, tmp_path: Path
) -> None:
    saved = load(inversion_folder)
    sound = {**saved.answer, "verdict": "consistent", "likelihood": "calibrated"}
    again = library_of(saved.answer, None)
    assert again is not None
    assert _belief(sound, again) == ("doubtful", UNCHECKED)
    assert _belief(sound, None) == ("doubtful", UNKNOWN)
    checked = Library.load("quick-plane-strain")
    assert _belief(sound, checked) == ("good", "")
    assert _belief({**sound, "leg": "plate"}, checked) == ("doubtful", UNCHECKED)
    printed = {**sound, "likelihood": "paper"}
    assert _belief(printed, checked) == ("doubtful", OTHER_LIKELIHOOD)
    assert _belief({**sound, "verdict": "misfit"}, again) == ("bad", "")
    (tmp_path / "answer.json").write_text(json.dumps(sound))
    html = render([section(tmp_path)])
    assert "no objection" not in html
    assert "nobody has checked" in html


def test_side_by_side_tells_two_answers_of_one_file_apart(
    inversion_folder: Path, tmp_path: Path
) -> None:
    answer = json.loads((inversion_folder / "answer.json").read_text())
    other = {
        **answer, "likelihood": "calibrated", "density_assumed": True,
        "error_budget": {"noise": "given", "noise_N": 0.05, "discrepancy": "gp", "shares": {}},
    }  # fmt: skip
    one = {**answer, "likelihood": "paper", "density_assumed": False, "error_budget": None}
    found = []
    for name, content in (("a", one), ("b", other)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "answer.json").write_text(json.dumps(content))
        found.append(section(tmp_path / name))
    (table,) = context(found)["overviews"]
    assert table.header[:2] == ("", "verdict")
    assert table.header[-4:] == ("likelihood", "density", "noise", "discrepancy")
    first, second = table.rows
    assert first[-4] == "paper"
    assert second[-4:] == ("calibrated", first[-3] + ", assumed", "given, 0.05 N", "gp")
    (table,) = context([found[0], found[0]])["overviews"]
    assert "likelihood" not in table.header


def test_without_a_certificate_the_page_says_so(inversion_folder: Path) -> None:
    texts = [part for part in section(inversion_folder).parts if isinstance(part, Text)]
    titles = [part.title for part in section(inversion_folder).parts]
    assert "Certificate of library rft3d" in titles
    assert all("nobody has tried" in text.paragraphs[0] for text in texts)


def test_the_budget_of_an_answer_that_has_one_is_told(
    inversion_folder: Path, tmp_path: Path
) -> None:
    answer = json.loads((inversion_folder / "answer.json").read_text())
    answer["error_budget"] = {
        "shares": {"noise": 0.2, "particle_scatter": 0.8},
        "degrees": {"noise": 0.05, "particle_scatter": 0.1},
    }
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    table = next(p for p in section(tmp_path).parts if "width of the interval" in p.title)
    assert isinstance(table, Table)
    assert table.rows == [("particle scatter", "0.1", "80%"), ("noise", "0.05", "20%")]


def test_a_calibrated_answer_that_fits_has_its_certificate(tmp_path: Path) -> None:
    library = Library.load("quick-plane-strain")
    history = Library.load("quick-plane-strain-truths").cases[0].history
    assert history is not None
    found = invert(history, library=library)
    found.to_netcdf(tmp_path / "posterior.nc")
    assert found.verdict.verdict == "consistent"
    page = section(tmp_path)
    certificate = next(p for p in page.parts if p.title.startswith("Certificate"))
    assert isinstance(certificate, Table)
    assert certificate.header == ("", "straight")
    told = plots(page)["Which angles told the friction angle"]
    assert "Beware" not in told.note
    assert told.layout["shapes"] == []


def test_a_file_of_the_first_schema_is_read_too(inversion_folder: Path, tmp_path: Path) -> None:
    # It had one history alone, without a dimension for it.
    with xr.open_datatree(inversion_folder / "posterior.nc", engine="h5netcdf") as opened:
        tree = opened.load()
    old = {"/posterior": tree["posterior"].to_dataset()[["phi_deg"]]}
    for name in ("observed_data", "posterior_predictive_mean"):
        old[f"/{name}"] = tree[name].to_dataset().isel(record=0).drop_vars(["source", "leg"])
    old["/observed_data"] = old["/observed_data"].rename(reading_0_deg="reading_deg")
    answer = json.loads(tree.attrs["answer"])
    for added in ("measures", "histories", "parameters", "fixed"):
        del answer[added]
    root = {"terraphi_file": "inversion", "terraphi_schema": 1, "answer": json.dumps(answer)}
    old["/"] = xr.Dataset(attrs=root)
    old["/information_share"] = tree["information_share"].to_dataset()
    xr.DataTree.from_dict(old).to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    one, other = load(inversion_folder), load(tmp_path / "posterior.nc")
    for name in ("draws_deg", "theta_deg", "data", "best", "share"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    page = section(tmp_path / "posterior.nc")
    assert page.headline == section(inversion_folder).headline
    assert other.band is None
    assert plots(page)["Fx"].note == NO_BAND


def test_forces_stand_beside_what_real_soils_would_have(tmp_path: Path) -> None:
    found = invert(measurement("li2013:yuma/straight").history, density=1650.0)
    found.to_netcdf(tmp_path / "posterior.nc")
    lines = {trace["name"]: trace for trace in plots(section(tmp_path))["Fz"].traces}
    expected = found.record.expected
    assert expected is not None
    drawn = lines["with the mean deviation of real soils"]["y"]
    assert drawn == pytest.approx(expected[40:], rel=1e-3, abs=1e-3)


def test_a_calibrated_answer_has_its_own_band_and_budget(tmp_path: Path) -> None:
    measured = measurement("li2013:yuma/straight")
    library = Library.load("quick-plane-strain")
    found = invert(measured.history, library=library, likelihood="calibrated")
    found.to_netcdf(tmp_path / "posterior.nc")
    page = section(tmp_path)
    band = plots(page)["Fz"].traces[0]
    top, floor = np.array(band["y"]).reshape(2, -1)
    np.testing.assert_allclose(top, found.record.band[1, 40:], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(floor[::-1], found.record.band[0, 40:], rtol=1e-3, atol=1e-4)
    titles = [part.title for part in page.parts]
    assert "What the width of the interval comes from" in titles
    # The record's leg touches the soil later than the model's: no angle explains that.
    assert found.verdict.verdict == "misfit"
    assert not any(part.title.startswith("Certificate") for part in page.parts)
    none = next(part for part in page.parts if part.title == "No certificate")
    assert isinstance(none, Text)
    assert "does not apply" in none.paragraphs[0]
    told = plots(page)["Which angles told the friction angle"]
    size = np.hypot(found.record.observation.Fx, found.record.observation.Fz)
    silent = size < 0.01 * size.max()
    assert silent.sum() == len(told.layout["shapes"]) == 3
    angles = found.record.observation.theta_deg[silent]
    for shape, theta in zip(told.layout["shapes"], angles, strict=True):
        assert shape["x0"] < theta < shape["x1"]
    part = sum(np.array(bars["y"])[silent].sum() for bars in told.traces[:2])
    assert f"Beware: {part:.0f}% comes from the shaded angles" in told.note
