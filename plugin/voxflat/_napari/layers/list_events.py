"""The events of napari's list of layers."""

from typing import Any

from napari.utils.events import Event


def list_events(layers: Any) -> tuple[Any, ...]:
    """Return the events for layers that are added, removed or renamed."""
    events = layers.events
    if "renamed" not in events.emitters:  # napari 0.6, which passes on the events of the layers themselves
        events.add(renamed=Event)
        events.connect(lambda event: events.renamed() if event.type == "name" else None)
    return events.inserted, events.removed, events.renamed
