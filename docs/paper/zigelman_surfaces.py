"""The surfaces of Zigelman, Kimmel, Kiryati (2002), as range images: a cylinder, sin x sin y, a bust."""

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

import voxflat

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))

import shapes


def cylinder(side=100, arc=150):
    """Return a part of a cylinder (figure 4), and where its vertices lie unrolled, mm; `arc` is in degrees."""
    half = np.radians(arc) / 2
    across = np.linspace(-np.sin(half), np.sin(half), side)
    radius = (side - 1) / (2 * np.sin(half))
    image = voxflat.range_image(np.broadcast_to(radius * np.sqrt(1 - across**2), (side, side)), 1.0)
    rows, columns = np.unravel_index(image.ids, (side, side))
    return image, np.stack([radius * np.arcsin(across[columns]), -rows], axis=1)


def waves(side=141, unit=1.0):
    """Return the graph of sin x sin y over a period (figure 11); x and y are in units of so many mm."""
    x = np.linspace(-np.pi, np.pi, side)
    return voxflat.range_image(unit * np.outer(np.sin(x), np.sin(x)), unit * 2 * np.pi / (side - 1))


def bust():
    """Return a bust, 1 mm a pixel (figure 3: a face), as one sheet, which the paper takes a range image to be."""
    return voxflat.range_image(bust_depth(), 1.0, jump=np.inf)


def bust_depth():
    """Return the depths of a bust; its grey levels are smoothed, for whole numbers make a staircase."""
    depth = shapes.head_depth().astype(float)
    pieces, _ = ndimage.label(ndimage.binary_opening(depth > 0, iterations=2))
    there = pieces == np.bincount(pieces.ravel())[1:].argmax() + 1
    share = ndimage.gaussian_filter(there.astype(float), 1.5)
    smooth = ndimage.gaussian_filter(np.where(there, depth, 0.0), 1.5)
    return np.where(there, smooth / np.where(there, share, 1), np.nan)
