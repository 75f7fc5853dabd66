"""Figures of the gap report: a quantity over time, its residual, and their spectra."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.residuals.gap import Channel
from twin.residuals.spectra import Spectrum, spectrum

from .drawing import DENSE_HZ, GAP_PX, TREND_HZ, Axis, Budget, Panels, Spans, thinned
from .page import BLACK, BLUE, GREY, Figure

Array = NDArray[np.float64]

MEASURED, TWIN, RESIDUAL = "measured", "nominal twin", "residual (measured - twin)"
SIGNAL_PX, RESIDUAL_PX = 165, 96
_LINES = (  # name, colour, dash, width over time
    (MEASURED, BLACK, "solid", 1.4),
    (TWIN, BLUE, "dash", 1.8),
    (RESIDUAL, GREY, "solid", 1.2),
)


def channel_figures(
    channels: Sequence[Channel], phases: Spans, time: str, budget: Budget
) -> tuple[Figure, Figure | None, str]:
    """Measured, twin and residual over time, one pair of panels per channel, and their spectra.

    Args:
        channels: Of one quantity and horizon.
        phases: Drawn as coloured background.
        time: Group of figures whose time axes move together.
        budget: Of the page.

    Returns:
        The figure over time; the spectra, one panel per channel, None where samples are too few;
        and a note on what the figures leave out ("" if nothing).
    """
    panels = Panels((SIGNAL_PX, RESIDUAL_PX) * len(channels), time)
    banded = False
    for channel in channels:
        banded |= _add_time(panels, channel, budget)
    ends = [(float(c.t_s[0]), float(c.t_s[-1])) for c in channels if len(c.t_s)]
    if ends:
        panels.look(min(e[0] for e in ends), max(e[1] for e in ends), phases)
    notes = []
    if banded:
        notes.append(f"curves: below {TREND_HZ:g} Hz; bands: all samples")
    spectra = [[spectrum(c.wide.t_s, x) for x in _three(c.wide)] for c in channels]
    if not any(s[0].rate_hz >= DENSE_HZ for s in spectra):
        return panels.figure, None, "; ".join(notes)
    rates = sorted({round(s[0].rate_hz) for s in spectra if math.isfinite(s[0].rate_hz)})
    notes.append(
        "spectra: Welch, samples resampled on their median rate "
        f"({', '.join(f'{r} Hz' for r in rates)})"
    )
    return panels.figure, _spectra_figure(channels, spectra, budget), "; ".join(notes)


def _three(channel: Channel) -> tuple[Array, Array, Array]:
    """What `_LINES` draws."""
    return channel.measured, channel.simulated, channel.residual


def _add_time(panels: Panels, channel: Channel, budget: Budget) -> bool:
    """Measured over twin, and the residual below; whether bands were drawn."""
    unit = pretty_unit(channel.unit)
    axes = [panels.add(f"{what}, {unit}") for what in (channel.name, "residual")]
    banded = False
    for i, (y, (name, color, dash, width)) in enumerate(zip(_three(channel), _LINES, strict=True)):
        line = {"color": color, "width": width, "dash": dash}
        shown = panels.series(axes[i == 2], channel.t_s, y, name, line, budget.columns)
        banded |= shown.band is not None
    finite = channel.residual[np.isfinite(channel.residual)]
    if len(finite) >= 20:  # 95 % of the residuals lie in the band
        low, high = np.percentile(finite, [2.5, 97.5])
        panels.area(axes[1], float(low), float(high))
    return banded


def _spectra_figure(
    channels: Sequence[Channel], spectra: Sequence[Sequence[Spectrum]], budget: Budget
) -> Figure:
    """Power spectral densities of measured, twin and residual, log-log, beside the panels over
    time."""
    panels = Panels((SIGNAL_PX + RESIDUAL_PX + GAP_PX,) * len(channels))
    for i, (channel, three) in enumerate(zip(channels, spectra, strict=True)):
        top = max(float(s.psd[s.f_hz > 0].max(initial=0.0)) for s in three)
        frequency: Axis = {"type": "log", "dtick": 1}
        if i == len(channels) - 1:
            frequency["title"] = {"text": "frequency, Hz"}
        density: Axis = {"type": "log", "exponentformat": "power"}
        if top > 0 and _spread(three) > 9:  # nine decades below the peak is rounding, not flight
            density["range"] = [math.log10(top) - 9, math.log10(top) + 0.5]
        title = f"{channel.name}: PSD, ({pretty_unit(channel.unit)})²/Hz"
        axes = panels.add(title, frequency, density)
        for s, (name, color, dash, _) in zip(three, _LINES, strict=True):
            keep = (s.f_hz > 0) & (s.psd > 0)
            f, log_psd = thinned(np.log10(s.f_hz[keep]), np.log10(s.psd[keep]), budget.spectrum)
            panels.line(
                axes,
                10**f,
                10**log_psd,
                name,
                {"color": color, "width": 1.3, "dash": dash},
                hovertemplate="%{y:.3g} at %{x:.3g} Hz<extra>" + name + "</extra>",
            )
    return panels.figure


def _spread(three: Sequence[Spectrum]) -> float:
    """Decades between the largest and the smallest positive density."""
    positive = np.concatenate([s.psd[(s.f_hz > 0) & (s.psd > 0)] for s in three])
    return float(np.log10(positive.max() / positive.min())) if len(positive) else 0.0


def pretty_unit(unit: str) -> str:
    """A unit as printed: `m/s2` is m/s²."""
    return unit.replace("^", "").replace("s2", "s²").replace("m2", "m²")


def number(value: float) -> str:
    """Three significant figures; a dash where there is no number."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e5):
        text = f"{value:.2e}"
    else:
        text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return text.replace("-", "\N{MINUS SIGN}")


def percent(share: float) -> str:
    """Two significant figures below 10 %; a dash where there is no number."""
    if not math.isfinite(share):
        return "\N{EN DASH}"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"
