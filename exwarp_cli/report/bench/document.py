"""The contract of bench.json, schema ``exwarp.bench/1``: a table or figure of the paper a key."""

from __future__ import annotations

from exwarp_cli import __version__
from exwarp_cli.accelerator.mac_array import Schedule
from exwarp_cli.pipeline.bench.work import Benchmark, Measured
from exwarp_cli.report.bench.choices import decisions_row, features_row, fps_row, holes_row
from exwarp_cli.report.bench.clocked import real_time
from exwarp_cli.report.bench.cost import predictor_cost, render_time_row, runtime_row
from exwarp_cli.report.bench.naming import Document, about_system, identify
from exwarp_cli.report.bench.quality import comparison_row, extranet_row, quality_row
from exwarp_cli.report.summary import finite

SCHEMA = "exwarp.bench/1"


def document(found: Benchmark, predictor: Schedule, clock_hz: float) -> Document:
    """Turn a benchmark into the dictionary of bench.json.

    Parameters
    ----------
    found
        What was measured.
    predictor
        The accelerator's schedule.
    clock_hz
        At which its time is stated.

    Returns
    -------
    dict
        None is what was not measured, never 0; no number is NaN or infinite. What the paper prints
        stands under ``paper``. ``real_time`` is there with a clock alone.
    """
    rows = found.measured
    clocked = {} if found.settings.clock is None else {"real_time": real_time(found)}
    plain: Document = finite(
        {
            "schema": SCHEMA,
            "version": __version__,
            "networks": found.networks,
            "metrics": sorted(found.settings.metrics),
            "systems": {name: about_system(name) for name in found.systems},
            "sequences": [_sequence(one) for one in rows],
            "runtime": [runtime_row(one) for one in rows],
            "holes": [holes_row(one) for one in rows],
            "features": [features_row([one], identify(one)) for one in rows]
            + [features_row(rows, {"name": "all", "setting": None, "size": None})],
            "quality": [quality_row(one) for one in rows],
            "comparison": [comparison_row(one) for one in rows],
            "fps": [fps_row(one) for one in rows],
            "decisions": [decisions_row(one) for one in rows],
            "predictor": predictor_cost(predictor, clock_hz),
            "extranet_procedure": [extranet_row(one) for one in rows],
            "render_time": [render_time_row(one) for one in rows],
            **clocked,
        }
    )
    return plain


def _sequence(one: Measured) -> Document:
    return identify(one) | {
        "intervals": len(one.parts),
        "fps": one.about["fps"],
        "producer": one.about["producer"],
        "policy": one.about["policy"],
        "machine": one.timing["machine"],
    }
