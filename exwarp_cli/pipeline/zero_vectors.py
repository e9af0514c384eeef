"""Vectors that are 0 throughout: why a renderer wrote them so, and what to do."""

from __future__ import annotations

from exwarp_cli.errors import MotionError

SETTINGS = {
    "Blender": "switch it off in Render Properties > Motion Blur, as Cycles writes no vectors with "
    "it",
    "Arnold": "Arnold writes vectors only with Motion Blur on: switch it on together with "
    "Instantaneous Shutter",
    "Redshift": "Redshift writes vectors only with Motion Blur on, and keeps the beauty sharp "
    "meanwhile: switch it on",
    "V-Ray": "switch it off in Render Settings > Motion Blur, and check that the Velocity element "
    "is on",
    "Karma": "switch it off in the Karma render settings > Rendering > Motion Blur",
    "RenderMan": "switch it off in Render Settings > Motion Blur",
}
"""What to do by producer, as `io.producers` names them."""

ANY = "switch it off in the renderer's settings"


def zero_vectors_error(names: tuple[str, ...], frames: str, producer: str) -> MotionError:
    """Return the error for vectors that are 0 while the picture moves.

    Parameters
    ----------
    names
        Of the motion channels.
    frames
        Numbers of the frames that were looked at.
    producer
        What wrote the files, as far as they tell.
    """
    advice = next((text for name, text in SETTINGS.items() if producer.startswith(name)), ANY)
    return MotionError(
        f"the motion channels {', '.join(names)} are 0 throughout in frames {frames}, while the "
        f"picture moves: motion blur was on, or the pass is empty; {advice}, and render the motion "
        "pass again; if nothing is meant to move, give --motion"
    )
