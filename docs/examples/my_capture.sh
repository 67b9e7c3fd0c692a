flatlight init
python my_capture.py          # or copy psf.tif and capture.tif of your own camera here
flatlight reconstruct capture.tif --stack psf.tif --frame physical --bits 12 --background 100 \
    --scene 128x128 --method admm --output found
