"""Known data sets as scene sources: a module per source, and the modules that they share.

A source module has a function of the same name, and may have ``recognises(path) -> bool`` and
``survey(path, progress=None, **options) -> Survey``, by which ``flatlight import --check`` finds and reads it.
"""

from simulator.importers.inspection import Progress, Survey

__all__ = ["Progress", "Survey"]
