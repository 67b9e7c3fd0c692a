"""report.html: a data set as one page to look at; see `simulator.plots.report.page.write_report`."""
