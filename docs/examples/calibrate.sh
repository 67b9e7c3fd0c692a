flatlight init
python my_lab.py          # or copy pictures of your own camera to lab/
flatlight calibrate lab/ --pixel-um 9.6 --bits 12
