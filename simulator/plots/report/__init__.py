"""report.html: a data set as one page to look at; see `simulator.plots.report.page.write_report`."""

SAMPLES = 24
"""Samples that a page shows when nothing is said."""
