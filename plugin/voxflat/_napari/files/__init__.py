"""Readers and writers: surfaces, values on surfaces, patches, volumes, flat maps and atlases."""
