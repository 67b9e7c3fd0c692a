"""Pictures of clips for people: contact sheets and animations.

One white level, one range of depths and one of motion hold for all of a picture, and stand on it.
"""

from simulator.preview.animation import ANIMATIONS, animation
from simulator.preview.sheet import clip_sheet

__all__ = ["ANIMATIONS", "animation", "clip_sheet"]
