"""From records and a library to the friction angle, its interval and a verdict.

Read in this order: ``records`` (what was measured), ``calibration`` (how real soils differ from the
model), ``estimator`` (least squares), ``likelihood`` (named terms, posterior), ``checks`` (what
looks wrong), ``answer``, ``inversion`` (all of it in one call).
"""

COLUMNS = (
    *("source", "leg", "phi_deg", "sd_deg", "ci68_low_deg", "ci68_high_deg", "ci95_low_deg"),
    *("ci95_high_deg", "yield", "phi_plane_strain_deg", "verdict", "reason", "nrmsd_Fx"),
    *("nrmsd_Fz", "nrmsd_M", "length_mm", "width_mm", "thickness_mm", "hip_height_mm"),
    *("density_kg_m3", "density_assumed", "law", "warnings"),
)
"""Columns of a table of answers."""
