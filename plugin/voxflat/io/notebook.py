"""Display results in Jupyter."""

import base64
import html
import io
from typing import Any

_DPI = 150  # dpi of pictures, 85 mm wide on paper


def page(value: object, text: str = "", figure: Any = None, about: str = "") -> str:
    """Return HTML for a value: its `repr`, a picture with a description, and text in aligned columns."""
    parts = [f"<p><code>{html.escape(repr(value))}</code></p>"]
    if figure is not None:
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=_DPI, format="png")
        figure.clear()  # its layout keeps the pixels in cycles
        data = base64.b64encode(drawn.getvalue()).decode()
        parts.append(f'<img alt="{html.escape(about)}" src="data:image/png;base64,{data}">')
    if text:
        parts.append(f"<pre>{html.escape(text)}</pre>")
    return "\n".join(parts)
