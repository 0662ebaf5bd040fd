"""Meshes for other norms of the error than its largest value: L1, L2 and the gradient's."""

from __future__ import annotations

from equimesh.norms.profile import NormProfile
from equimesh.norms.remesh import remesh_norm

__all__ = ["NormProfile", "remesh_norm"]
