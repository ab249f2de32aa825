"""What the user fills in: which layer, which part of it, how it is flattened."""
