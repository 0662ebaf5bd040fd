"""Meshes that are unit in a given Riemannian metric."""
