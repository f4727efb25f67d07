"""Scenes and reference numbers that travel with the package; every number carries its source."""
