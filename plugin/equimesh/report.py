"""A result as a table for people and as JSON for programs."""

from __future__ import annotations

import json
import math
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from equimesh.profile import Profile
    from equimesh.result import Result

__all__ = ["as_json", "installed_version", "of_profile", "of_result", "table"]

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


def installed_version() -> str | None:
    """The version of the installed distribution; None for a checkout that is not installed."""
    try:
        return version("equimesh")
    except PackageNotFoundError:
        return None


def of_result(result: Result, seconds: Mapping[str, float]) -> dict[str, Any]:
    """What ``--report`` writes about a remeshing; ``seconds`` by stage."""
    return {
        "status": result.status.name.lower(),
        "tol": result.tol,
        "bound": result.profile.over,
        "norm": getattr(result.profile, "norm", "max"),
        **_of_mesh(result.profile),
        "lower_bound": result.lower_bound,
        "efficiency": result.efficiency,
        "seed": result.seed,
        "seconds": dict(seconds),
        "version": installed_version(),
    }


def of_profile(
    profile: Profile, seconds: Mapping[str, float], at_samples: Profile | None = None
) -> dict[str, Any]:
    """What ``--report`` writes about a mesh that came from elsewhere.

    ``at_samples``: the same mesh measured at the samples of a raster only.
    """
    figures = {"bound": profile.over, **_of_mesh(profile)}
    if at_samples is not None:
        figures["max_error_at_samples"] = at_samples.max
    return {**figures, "seconds": dict(seconds), "version": installed_version()}


def _of_mesh(profile: Profile) -> dict[str, Any]:
    return {
        "triangles": len(profile.triangles),
        "vertices": len(profile.points),
        "max_error": profile.max,
        "error_bound": profile.bound,
        "quantiles": _quantiles(profile.errors),
        "smallest_angles": _quantiles(profile.angles),
    }


def _quantiles(values: NDArray[np.float64]) -> dict[str, float]:
    return {f"{q:g}": float(np.quantile(values, q)) for q in QUANTILES}


def as_json(report: Mapping[str, Any]) -> str:
    """Strict JSON: what is not a finite number becomes null."""
    return json.dumps(_plain(report), indent=2, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def table(report: Mapping[str, Any], source: str) -> Table:
    """The report in a few lines; ``source`` says what went in."""
    rows = Table(show_header=False, box=None, pad_edge=False)
    rows.add_column(style="bold")
    rows.add_column(justify="right")
    rows.add_row("input", source)
    rows.add_row("triangles", f"{report['triangles']:,}")
    rows.add_row("vertices", f"{report['vertices']:,}")
    if "tol" in report:
        rows.add_row("tolerance", _number(report["tol"]))
    where = " at samples" if report.get("bound") == "samples" else ""
    rows.add_row(f"largest error{where}", _number(report["max_error"]))
    rows.add_row(f"bound on the error{where}", _number(report["error_bound"]))
    if "max_error_at_samples" in report:
        rows.add_row("largest error at samples", _number(report["max_error_at_samples"]))
    if "smallest_angles" in report:
        angles = report["smallest_angles"]
        three = " / ".join(f"{angles[q]:.3g}" for q in ("0", "0.05", "0.5"))
        rows.add_row("smallest angles, least / 5 % / median", f"{three} degrees")
    if "lower_bound" in report:
        rows.add_row("N*, fewest possible", _number(report["lower_bound"], ",.0f"))
        rows.add_row("efficiency N*/N", _number(report["efficiency"], ".3f"))
    for stage, seconds in report["seconds"].items():
        rows.add_row(f"seconds, {stage}", f"{seconds:.2f}")
    return rows


def _number(value: float, form: str = ".6g") -> str:
    return format(value, form) if math.isfinite(value) else "not known"
