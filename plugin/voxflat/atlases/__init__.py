"""Atlases: a surface in flat pieces, certified or glued, and the page on which they are placed.

From bottom to top: `layout` works on arrays; `pieces` holds a surface in pieces, and `page` places them side by side;
`atlas` is the base class of atlases; `glued` and `certified` are the two kinds; `making` makes one of a surface.
"""
