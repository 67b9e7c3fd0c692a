flatlight init
flatlight render sim_config.yaml --set scene.family=./my_scenes.py:marbles --samples 6 --output my_scenes.png
