"""The vibrating structures of a scene: an infinite lattice, a finite structure, or both."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ase import Atoms

    from ..scenes.scene import Scene


def lattice_and_patch(scene: Scene) -> tuple[Atoms | None, Atoms | None, list[str]]:
    """The lattice of a scene, its patch or finite structure, and lines that say what is left out.

    Raises
    ------
    ValueError
        For the oscillator, which has neither.
    """
    if scene.single:
        raise ValueError('the oscillator is one particle, with neither bands nor modes to count; "magphonon frf" is for it')
    if scene.finite:
        return None, scene.patch_atoms(), []
    if scene.patch is None:
        return scene.atoms(), None, []
    if scene.law.shells != 1:
        return scene.atoms(), None, ['the patch is left out: the forces on its rim balance between nearest neighbours only']
    return scene.atoms(), scene.patch_atoms(), []
