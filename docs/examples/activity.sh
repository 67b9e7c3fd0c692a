flatlight init --preset activity_64
flatlight generate activity_64.yaml --set dataset.train=0 --set dataset.validation=0 --set dataset.test=14
flatlight reconstruct out/activity_64/test/0000/s00000000
