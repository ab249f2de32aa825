"""The results of a run: the layers of the map, the measures, and the panel that shows the measures."""
