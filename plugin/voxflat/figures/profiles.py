"""Draw profiles of values along cortical depth."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from voxflat.arguments import checked_instance, checked_text
from voxflat.errors import InputError
from voxflat.figures.names import plain
from voxflat.laminar.profile import Profile

_MOST_LINES = 20


def profile(profile: Profile, *, label: str | None = None, ax: Axes | None = None) -> Figure:
    """Draw values along cortical depth, from white matter to cerebrospinal fluid.

    There is one line per region and channel, with a band of one standard deviation on both sides of the mean.

    Parameters
    ----------
    profile : Profile
        The values, as `Rim.profile` returns them.
    label : str, optional
        Label of the vertical axis, with the unit; by default, the file name of the volume.
    ax : matplotlib.axes.Axes, optional
        Draw into these axes instead of a new figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, or the figure of `ax`.

    Raises
    ------
    InputError
        If there are more than 20 lines.

    See Also
    --------
    save : Write the figure to a file.

    Examples
    --------
    >>> rim = voxflat.rim(voxflat.samples.rim())
    >>> figure = voxflat.figures.profile(rim.profile(rim.thickness()), label="thickness (mm)")
    >>> voxflat.figures.save(figure, "profile.pdf")
    """
    checked_instance(profile, Profile, "profile", "a Profile, as returned by Rim.profile")
    label = checked_text(label, "label") or profile.name or "mean"
    regions, layers = profile.mean.shape[:2]
    mean, sd = (values.reshape(regions, layers, -1) for values in (profile.mean, profile.sd))
    lines = [(region, channel) for region in range(regions) for channel in range(mean.shape[2])]
    if len(lines) > _MOST_LINES:
        reason = f"the profile has {len(lines)} lines ({regions} regions, {mean.shape[2]} channels)"
        raise InputError(f"{reason}, but a figure shows at most {_MOST_LINES}. Choose fewer regions, or one channel")
    if ax is None:
        ax = Figure(figsize=(6.6, 4.2), layout="constrained").add_subplot()
    colours = colormaps["tab10" if len(lines) <= 10 else "tab20"].colors  # type: ignore[attr-defined]
    for (region, channel), colour in zip(lines, colours, strict=False):
        names = [profile.names[region]] if regions > 1 or not profile.channels else []
        names += [f"channel {profile.channels[channel]}"] if profile.channels else []
        middle, spread = mean[region, :, channel], np.nan_to_num(sd[region, :, channel])
        label_of = plain(", ".join(names), 80)
        label_of = f" {label_of}" if label_of.startswith("_") else label_of  # which hides a line from the legend
        ax.plot(profile.depths, middle, color=colour, marker="o", markersize=3, linewidth=1.4, label=label_of)
        ax.fill_between(profile.depths, middle - spread, middle + spread, color=colour, alpha=0.18, linewidth=0)
    ax.set(xlim=(0, 1), xlabel=f"{profile.layering} depth", ylabel=plain(label, 80))
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0\nwhite matter", "0.25", "0.5", "0.75", "1\nCSF"])
    ax.legend(title="mean ± sd", frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    figure = ax.get_figure()
    assert isinstance(figure, Figure)
    return figure
