flatlight init --preset moving_3d_64
flatlight generate moving_3d_64.yaml --set dataset.train=0 --set dataset.validation=0 --set dataset.test=1
flatlight reconstruct out/moving_3d_64/test/0000/s00000000
