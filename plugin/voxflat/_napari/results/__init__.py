"""The results of a run: the layers of the map, its measures, and the panel that shows them."""
