"""Measure cortical depth in a segmentation of the grey matter, without given surfaces."""
