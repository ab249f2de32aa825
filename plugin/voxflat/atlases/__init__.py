"""Atlases: a surface in flat pieces, certified or glued, and the page they lie on.

From below: `layout` knows arrays alone; `pieces` holds a surface in pieces, `page` lays them side by side, `atlas` is
what all atlases can do; `glued` and `certified` are the two kinds; `making` makes one of a surface.
"""
