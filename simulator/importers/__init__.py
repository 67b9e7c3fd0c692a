"""Known data sets as scene sources: a module per source, and the modules that they share.

A source module has a function of the same name, and may have ``recognises(path) -> Likeness | None`` and
``survey(path, progress=None, **options) -> Survey``, by which ``flatlight import --check`` finds and reads it.
"""

from simulator.importers.inspection import Likeness, Progress, Survey

__all__ = ["Likeness", "Progress", "Survey"]
