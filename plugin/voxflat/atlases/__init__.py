"""Atlases: a surface in flat pieces, certified or glued, and the page they lie on."""
