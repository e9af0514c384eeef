"""What the paper prints: Dixit, Chakrabarty, Sarangi, *ExWarp: Extrapolation and Warping-based
Temporal Supersampling for High-frequency Displays*.

Applications are the paper's abbreviations: LB (Lab), TR (Tropical), VL (Village), TN (Town) and SL
(Slum) at 480p, TN2 and SL2 at 720p, TN3 and SL3 at 1080p, on an RTX A4000 in Unreal.
"""

from __future__ import annotations

from exwarp_cli.domain.decision import PATHS

# Abbreviation by the name of our scene of the same theme.
SCENES = {"lab": "LB", "tropical": "TR", "village": "VL", "town": "TN", "slum": "SL"}

# Least height, and what is added to the abbreviation from there on. 240p is compared with 480p, the
# paper's smallest; `RUNTIME` and `QUALITY` lack applications that it does not have at that size.
SIZES = ((900, "3"), (600, "2"), (0, ""))

# Table III, "Runtime (ms) breakdown of the ExtraNet model", by step: see `RUNTIME_STEPS`.
RUNTIME = {
    "LB": (0.17, 0.95, 1.94, 3.67),
    "TR": (0.36, 0.89, 1.89, 3.78),
    "VL": (0.48, 0.83, 1.81, 3.45),
    "TN": (0.34, 0.96, 1.89, 3.61),
    "TN2": (1.01, 1.58, 2.49, 7.04),
    "TN3": (1.02, 2.89, 4.57, 13.54),
    "SL": (0.24, 0.95, 1.93, 3.55),
    "SL2": (1.24, 1.67, 2.59, 7.09),
    "SL3": (2.1, 2.91, 4.63, 13.78),
}
RUNTIME_STEPS = ("gbuffer", "warping", "hole_marking", "inference")

# Applications of Table III by the size of their frames.
RUNTIME_APPS = {
    "480p": ("LB", "TR", "VL", "TN", "SL"),
    "720p": ("TN2", "SL2"),
    "1080p": ("TN3", "SL3"),
}

_PSNR = {
    "LB": (20.63, 20.58, 20.05, 23.91, 21.43, 25.01, 28.65),
    "TR": (19.82, 19.18, 19.11, 22.60, 20.19, 23.68, 17.30),
    "VL": (20.33, 19.92, 24.90, 36.36, 32.68, 43.70, 44.66),
    "TN": (18.29, 17.56, 16.94, 19.71, 19.97, 17.39, 24.10),
    "TN2": (18.70, 16.85, 15.60, 17.98, 17.35, 15.06, 17.12),
    "TN3": (19.26, 17.14, 15.64, 17.91, 16.98, 14.79, 17.01),
    "SL": (29.06, 28.86, 30.11, 31.38, 32.10, 30.93, 32.62),
    "SL2": (31.17, 29.20, 28.20, 29.97, 26.83, 27.59, 32.33),
    "SL3": (30.99, 29.40, 27.83, 28.52, 26.43, 26.90, 32.03),
}

_SSIM = {
    "LB": (0.64, 0.63, 0.55, 0.76, 0.60, 0.81, 0.87),
    "TR": (0.63, 0.59, 0.51, 0.69, 0.54, 0.71, 0.55),
    "VL": (0.80, 0.77, 0.69, 0.92, 0.75, 0.99, 0.99),
    "TN": (0.75, 0.73, 0.64, 0.78, 0.79, 0.65, 0.81),
    "TN2": (0.78, 0.71, 0.61, 0.70, 0.66, 0.56, 0.69),
    "TN3": (0.82, 0.74, 0.62, 0.72, 0.66, 0.57, 0.71),
    "SL": (0.88, 0.87, 0.77, 0.92, 0.94, 0.78, 0.93),
    "SL2": (0.88, 0.85, 0.72, 0.88, 0.71, 0.87, 0.87),
    "SL3": (0.88, 0.86, 0.72, 0.87, 0.72, 0.87, 0.87),
}

_SYSTEMS = (*(name.lower() for name in PATHS), "exwarp")

# Table VI, "Performance comparison across all scenarios"; s1 is ExtraNet.
QUALITY = {
    app: {
        system: {"psnr_db": psnr, "ssim": ssim}
        for system, psnr, ssim in zip(_SYSTEMS, _PSNR[app], _SSIM[app], strict=True)
    }
    for app in _PSNR
}

_EMA_PSNR = (49.52, 24.60, 20.86, 14.40, 13.42, 14.15, 28.57, 24.58, 32.53)
_EMA_SSIM = (0.99, 0.97, 0.94, 0.82, 0.71, 0.75, 0.61, 0.40, 0.75)
_SPLAT_PSNR = (48.74, 23.42, 20.54, 13.84, 13.47, 14.53, 24.07, 22.74, 34.95)
_SPLAT_SSIM = (0.99, 0.95, 0.93, 0.77, 0.59, 0.64, 0.26, 0.27, 0.83)

# Table VII, "Performance comparison with the state-of-the-art"; the two interpolations. Its other
# columns, ExtraNet and ExWarp, are s1 and exwarp of Table VI (but 24.11 dB for ExWarp on TN, and
# 31.16 and 19.27 dB for ExtraNet on SL2 and TN3).
INTERPOLATION = {
    app: {
        "EMA-VFI": {"psnr_db": ema_psnr, "ssim": ema_ssim},
        "Softmax Splatting": {"psnr_db": splat_psnr, "ssim": splat_ssim},
    }
    for app, ema_psnr, ema_ssim, splat_psnr, splat_ssim in zip(
        _PSNR, _EMA_PSNR, _EMA_SSIM, _SPLAT_PSNR, _SPLAT_SSIM, strict=True
    )
}

# Figure 2, as far as the text has its numbers.
HOLES = {
    "LB": "almost 90 % of the frames have less than 10 % holes",
    "TR": "more than 60 % of the frames have more than 20 % holes",
}

# Figure 8, as far as the text has its numbers.
EFFECTIVE_FPS = "more than 100 for every application, almost 110 on average"

# Figure 9: mean share of warps among the decisions; 80:20 for most applications.
WARP_SHARE = 0.7586

# Figure 4, as far as the text describes it.
CORRELATION = "PSNR of warped frames falls as each feature rises"

# Table "Overheads of the hardware predictor": Cadence Genus, TSMC 28 nm.
AREA_MM2, POWER_MW, LATENCY_NS = 0.12, 9.12, 6.2
