"""Makes the pictures of the site: ``uv run --extra learn python docs/pictures.py KIND [NAME ...]``.

``examples``: runs scripts of ``docs/examples``, each in an empty folder, and keeps what they draw.
``designs``, ``scenes``: the galleries, pages and all (``--text`` writes the pages alone).
``front``: the two pictures of the first page, from the data set of the default configuration, whose folder is named.
``others``: prints which command draws each of the others; evaluations take hours.
"""

from __future__ import annotations

import argparse
import base64
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from galleries import GALLERIES
from PIL import Image

DOCS = Path(__file__).parent
IMAGES, SCRIPTS = DOCS / "images", DOCS / "examples"
HEIGHT, GAP, WIDEST, QUALITY = 256, 8, 1400, 85

# What each script writes, to be shown side by side as docs/images/examples/NAME.webp; #3 is the third picture of a page.
EXAMPLES = {
    "light_path.py": ["light_path.png"],
    "my_mask.sh": ["my_mask.png"],
    "my_scenes.sh": ["my_scenes.png"],
    "my_capture.sh": ["capture.png", "found/image.png"],
    "calibrate.sh": [f"lab_calibrated/report.html#{number}" for number in (1, 4, 5)],
    "depth.sh": ["test_s00000000_flatnet3d/image.png", "test_s00000000_flatnet3d/depth.png"],
    "video.sh": ["test_s00000000_videonet/film.png"],
    "moving_3d.sh": ["test_s00000000_videonet3d/film.png"],
    "activity.sh": ["test_s00000000_activitynet/film.png"],
    "shutter.sh": ["figures/flashes_along_the_columns.png"],
    "deepinv_pnp.py": ["deepinv_pnp.png"],
    "deepinv_unfolded.py": ["deepinv_unfolded.png"],
    "shards.sh": ["out/flying_things_64/contact_sheet.png"],
}
OTHERS = {  # the command that draws it, and its file; the headers of the presets name what comes before an evaluation
    "scenes.webp": "flatlight scenes --thumbnails scenes.png",
    "reconstructions.png": "flatlight evaluate evaluate_64.yaml: montage.png",
    "clips.webp": "flatlight evaluate evaluate_video_64.yaml: films.webp",
    "moving_3d.webp": "flatlight evaluate evaluate_moving_3d_64.yaml: films.webp",
    "activity.webp": "flatlight evaluate evaluate_activity_64.yaml: the sheet of predictions",
    "confidence.webp": "flatlight confidence out/flying_things_64 --checkpoint flatnet3d: flatnet3d.confidence.png",
    "report.webp": "flatlight generate sim_config.yaml: report.html, in a browser window of 1600 x 696",
}
FRONT = ["capture.png", "refocus.png"]


def run(name: str, folder: Path, *arguments: str) -> None:
    """Run a script of `docs/examples` in a folder, with its neighbours and the default configuration beside it.

    Raises:
        CalledProcessError: it ended with another status than 0.
    """
    shutil.copytree(SCRIPTS, folder, dirs_exist_ok=True)
    shutil.copy(DOCS.parent / "sim_config.yaml", folder)
    if name.endswith(".sh"):
        (folder / "sim_config.yaml").unlink()  # `flatlight init` writes it
    shell = ["bash", "-e"] if name.endswith(".sh") else [sys.executable]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    subprocess.run([*shell, name, *arguments], cwd=folder, env=os.environ | {"PATH": path}, check=True)


def drawn(name: str, folder: Path) -> Image.Image:
    """Return what an example drew in a folder as one picture."""
    tiles = [_picture(folder, file).convert("RGB") for file in EXAMPLES[name]]
    if len(tiles) > 1:
        tiles = [
            tile.resize((round(tile.width * HEIGHT / tile.height), HEIGHT), Image.Resampling.BICUBIC) for tile in tiles
        ]
    sheet = Image.new("RGB", (sum(tile.width + GAP for tile in tiles) - GAP, tiles[0].height), "white")
    left = 0
    for tile in tiles:
        sheet.paste(tile, (left, 0))
        left += tile.width + GAP
    sheet.thumbnail((WIDEST, 10 * WIDEST))
    return sheet


def _picture(folder: Path, file: str) -> Image.Image:
    page, _, number = file.partition("#")
    if not number:
        return Image.open(folder / file)
    found = re.findall(r"data:image/png;base64,([^\"]+)", (folder / page).read_text(encoding="utf-8"))
    return Image.open(io.BytesIO(base64.b64decode(found[int(number) - 1])))


def example_picture(name: str) -> Path:
    """Return where the picture of an example lies."""
    return IMAGES / "examples" / f"{Path(name).stem}.webp"


def main() -> None:
    """Make what is named, or all of a kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["examples", "front", "others", *GALLERIES])
    parser.add_argument("names", nargs="*", help="what to draw; all when left out")
    parser.add_argument("--text", action="store_true", help="write a gallery's page alone, and draw nothing")
    chosen = parser.parse_args()
    if chosen.kind == "others":
        print(*(f"{picture}: {command}" for picture, command in OTHERS.items()), sep="\n")
    elif chosen.kind in GALLERIES:
        GALLERIES[chosen.kind].make(chosen.kind, chosen.names, text_only=chosen.text)
    else:
        for name in ["refocus.py"] if chosen.kind == "front" else chosen.names or EXAMPLES:
            with tempfile.TemporaryDirectory() as folder:
                if chosen.kind == "front":
                    run(name, Path(folder), str(Path(*chosen.names).resolve()), "7")
                    for picture in FRONT:
                        shutil.copy(Path(folder) / picture, IMAGES / picture)
                else:
                    run(name, Path(folder))
                    path = example_picture(name)
                    path.parent.mkdir(exist_ok=True)
                    drawn(name, Path(folder)).save(path, quality=QUALITY, method=6)
                    print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
