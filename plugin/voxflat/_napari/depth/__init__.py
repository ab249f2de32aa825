"""The dock *Cortical depth*: layers, flat volumes and profiles of a rim."""
