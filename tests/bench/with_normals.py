"""The command ``exwarp`` with every method reading normals, ``python -m tests.bench.with_normals``.

What decoding them takes is told so from what a policy's features take, for which they are read.
"""

from __future__ import annotations

from exwarp_cli.cli import main
from exwarp_cli.pipeline import key_frames

if __name__ == "__main__":
    # Before the module that reads asks for it by name.
    key_frames.frames_need_normals = lambda shot, extrapolates: True
    main()
