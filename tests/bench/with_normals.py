"""The command ``exwarp`` with every method reading normals, ``python -m tests.bench.with_normals``.

So the cost of decoding them is known apart from that of a policy's features, which read them.
"""

from __future__ import annotations

from exwarp_cli.cli import main
from exwarp_cli.pipeline import key_frames

if __name__ == "__main__":
    # Before the module that reads asks for it by name.
    key_frames.frames_need_normals = lambda shot, extrapolates: True
    main()
