"""The command ``exwarp`` with every method reading normals, ``python -m tests.bench.with_normals``.

So the cost of decoding them is known apart from that of a policy's features, which read them.
"""

from __future__ import annotations

from exwarp_cli.cli import main
from exwarp_cli.pipeline.key_frames import KeyFrameStore

if __name__ == "__main__":
    # Whatever a store finds out for itself.
    KeyFrameStore._needs_normals = property(lambda store: True, lambda store, needs: None)
    main()
