"""Readers and writers of surfaces, values on surfaces, patches, volumes, flat maps and atlases."""
