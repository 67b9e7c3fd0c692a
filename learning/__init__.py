"""Networks, baselines and training on Flatlight data sets (extra ``learn``)."""
