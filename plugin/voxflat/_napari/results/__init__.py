"""What a run gives: layers of the map, figures, and the view of them."""
