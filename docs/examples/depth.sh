flatlight init --preset flying_things_64
flatlight generate flying_things_64.yaml --set psf.as_captured=null \
    --set dataset.train=0 --set dataset.validation=0 --set dataset.test=1
flatlight reconstruct out/flying_things_64/test/0000/s00000000
