"""Means of per-frame scores, as every report writes them."""

from __future__ import annotations

from collections.abc import Iterable

from exwarp_cli.domain.results import Score


def mean(values: Iterable[float]) -> float | None:
    """Mean of the values, or None where there are none."""
    listed = [float(value) for value in values]
    return sum(listed) / len(listed) if listed else None


def quality(scores: Iterable[Score | None]) -> dict[str, float | int | None]:
    """Average the scores that are there.

    Returns
    -------
    dict
        ``psnr_db``, ``ssim`` and ``flip``, each the mean of the per-frame values, None where no
        frame was scored; ``frames``, how many were.
    """
    known = [score for score in scores if score is not None]
    return {
        "psnr_db": mean(score.psnr_db for score in known),
        "ssim": mean(score.ssim for score in known),
        "flip": mean(score.flip for score in known),
        "frames": len(known),
    }
