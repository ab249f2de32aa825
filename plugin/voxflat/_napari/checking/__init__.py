"""What *Layers → Measure* tells: of surfaces before they are flattened, and of maps."""
