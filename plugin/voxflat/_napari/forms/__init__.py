"""Forms in which the user chooses the layer, the part of it to flatten, and the options."""
