"""Forms in which the user chooses a layer, the part of it to flatten, and the options."""
