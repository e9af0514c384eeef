"""Whether what training needs is installed."""

from __future__ import annotations

from importlib.util import find_spec

from exwarp_cli.errors import MissingExtraError

PACKAGES = ("torch", "onnx", "onnxscript")
"""What the extra `train` adds."""


def require_train() -> None:
    """Raise MissingExtraError where the extra `train` is not installed; imports nothing."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"this needs {', '.join(missing)}, which the extra 'train' brings; "
            'pip install "exwarp[train]"'
        )
