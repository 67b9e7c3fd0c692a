"""Known data sets as scene sources: a module per source, and beside it the packages of its parts.

A source module has a function of its own name, and may have ``recognises(path) -> bool`` and
``survey(path, progress=None, **options) -> Survey``, by which ``flatlight import --check`` finds and reads it.
"""

from simulator.importers.inspection import Progress, Survey

__all__ = ["Progress", "Survey"]
