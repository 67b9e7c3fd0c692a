flatlight init --preset flying_things_64
small="--set psf.as_captured=null --set dataset.train=3 --set dataset.validation=1 --set dataset.test=1"
flatlight generate flying_things_64.yaml $small --shard 0/2
flatlight status out/flying_things_64 --shards 2
flatlight generate flying_things_64.yaml $small --shard 1/2
flatlight verify out/flying_things_64 --deep 1
python read.py
python refocus.py out/flying_things_64 0
