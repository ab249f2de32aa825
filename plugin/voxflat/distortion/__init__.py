"""What flattening did to distances and triangles: figures, and tables of them."""
