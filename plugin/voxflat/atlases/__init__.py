"""Atlases: surfaces divided into flat pieces, certified or glued, and the pages on which the pieces are placed.

From bottom to top: `layout` works on arrays; `pieces` holds a surface divided into pieces, and `page` places the pieces
side by side; `atlas` is the base class of atlases; `glued` and `certified` are the two kinds; `making` makes an atlas
from a surface.
"""
