"""The parts of `flatlight evaluate`: methods, scores, their cache and summary, times, tables and figures."""
