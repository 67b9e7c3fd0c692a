flatlight init
flatlight psf sim_config.yaml --plot my_mask.png \
    --set 'camera.mask={design: ./my_mask.py:vortex, width_mm: 0.6, charge: 8}' \
    --set 'psf={depths_cm: [4, inf]}' --set camera.sensor.binning=2
