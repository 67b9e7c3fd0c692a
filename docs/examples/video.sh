flatlight init --preset high_speed_64
flatlight generate high_speed_64.yaml --set dataset.train=0 --set dataset.validation=0 --set dataset.test=1
flatlight reconstruct out/high_speed_64/test/0000/s00000000
