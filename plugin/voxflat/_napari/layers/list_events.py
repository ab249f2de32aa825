"""The events of napari's layer list."""

from typing import Any

from napari.utils.events import Event


def list_events(layers: Any) -> tuple[Any, ...]:
    """Return the events that are emitted when layers are added, removed or renamed."""
    events = layers.events
    if "renamed" not in events.emitters:  # napari 0.6, which forwards the events of layers
        events.add(renamed=Event)
        events.connect(lambda event: events.renamed() if event.type == "name" else None)
    return events.inserted, events.removed, events.renamed
