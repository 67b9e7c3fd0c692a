"""Every value that makes no sense is refused at its line and column, with the reason."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.config import load_config
from simulator.errors import InputError

COMPUTED = "  near_cm: 3.6\n  far_cm: 20\n  depths: 5\n"
MASK = 'mask: {design: "./plugins.py:mask", width_mm: 2}'
NOISE = "noise: {type: gaussian, psnr_db: 40}"
GAP = "mask_to_sensor_mm: 1.9"
SENSOR = "sensor: {shape: [64, 96], binning: 4}"
DATASET = "dataset: {output: out, train: 2}"
MEASURED = "  measured: [a.tif, b.tif]\n  depths_cm: [5, inf]\n  frame: stored\n  throughput_mm2: 2\n"

# Piece of the file, what takes its place with a ^ where the message must point (else line:column), the message's parts.
REFUSED = [
    # numbers in another unit, and on the wrong side
    ("mm: 1.9", "mm: ^532", "", ["camera.mask_to_sensor_mm:", "0.05 to 100 mm"]),
    ("binning: 4", "pixel_pitch_um: ^2.4e-6", "", ["0.3 to 100 um"]),
    ("binning: 4", "bit_depth: ^3", "", ["4 to 24 bits"]),
    ("binning: 4", "prnu_percent: ^51", "", ["0 to 50 percent"]),
    ("binning: 4", "read_noise_e: ^-1", "", ["0 to 10000 e"]),
    ("exposure_ms: 5", "exposure_ms: ^0", "", ["0.0001 to 100000 ms"]),
    ("psnr_db: 40", "psnr_db: ^121", "", ["0 to 120 dB"]),
    ("near_cm: 3.6", "near_cm: ^-3.6", "", ["psf.near_cm:"]),
    ("near_cm: 3.6", "near_cm: ^0.036", "", ["1.9 mm"]),
    (COMPUTED, "  depths_cm: [^0.1, 5]\n", "", ["psf.depths_cm[0]:"]),
    # names that no file can have
    ("output: out", "output: ^~nobody-at-all/x", "", ["dataset.output:"]),
    ("output: out", f"output: ^{'x' * 300}", "", ["dataset.output:"]),
    ("binning: 4", "spectral_response: ^~nobody-at-all/x.csv", "", ["camera.sensor.spectral_response:"]),
    (MASK, "mask: {design: ^~nobody-at-all/m.py:mine}", "", ["camera.mask.design:"]),
    (MASK, "mask: {design: height_map, file: ^~nobody-at-all/x.npy, pixel_um: 2}", "", ["camera.mask.file:"]),
    # layers
    (GAP, "^gap: [{mm: 1, n: air}]\n  mask_to_sensor_mm: 1.9", "", ["camera.gap:", "mask_to_sensor_mm"]),
    (GAP, "gap: [{mm: 1.2, n: 1}, ^{mm: 0.7}]", "", ["camera.gap[1]:"]),
    (GAP, "gap: [{mm: 1.2, n: ^1.5, material: n-bk7}]", "", ["camera.gap[0].n:"]),
    (GAP, "gap: [{mm: 1.2, n: ^water}]", "", ["camera.gap[0].n:", "'water'"]),
    (GAP, "gap: [{mm: ^0, n: air}]", "", ["camera.gap[0].mm:", "0.0001 to 100 mm"]),
    (GAP, "gap: ^[{mm: 0.01, n: air}, {mm: 0.02, n: 1.5}]", "", ["camera.gap:"]),
    (GAP, f"{GAP}\n  substrate: {{mm: ^36, material: pmma, side: scene}}", "", ["36 mm", "3.6 cm"]),
    (GAP, "gap: ^[]", "", ["camera.gap:"]),
    (GAP, "gap: [{mm: 1.2, ^nn: air}]", "", ["camera.gap[0].nn:"]),
    (GAP, "gap: [{mm: 1.2, material: ^glass}]", "", ["camera.gap[0].material:", "'glass'"]),
    (GAP, "gap: [{mm: 1.2, material: ^glass.csv}]", "", ["camera.gap[0].material:", "glass.csv:"]),
    ("mm: 1.9", "mm: 1.9\n  ^substrate: {mm: 1, material: pmma}", "", ["camera.substrate.side:"]),
    (GAP, f"{GAP}\n  substrate: {{mm: 1, material: ^pmm, side: scene}}", "", ["camera.substrate.material:", "'pmm'"]),
    ("mm: 1.9", "mm: 1.9\n  substrate: {mm: 1, material: pmma, side: ^left}", "", []),
    # light
    (NOISE, "illuminant: {led_nm: ^5.3e-7, fwhm_nm: 20}", "", ["camera.illuminant.led_nm:", "200 to 2000 nm"]),
    (NOISE, "^illuminant: {led_nm: 532}", "", ["camera.illuminant.fwhm_nm:"]),
    (NOISE, "illuminant: [{led_nm: 532, fwhm_nm: ^0.1}]", "", ["camera.illuminant[0].fwhm_nm:"]),
    (NOISE, "illuminant: ^''", "", ["camera.illuminant:"]),
    (NOISE, "illuminant: ^lamp.csv", "", ["camera.illuminant:", "lamp.csv:"]),
    (
        "depths: 5",
        "depths: 5\n  as_captured: {illuminant: ^lamp.csv}",
        "",
        ["psf.as_captured.illuminant:", "lamp.csv:"],
    ),
    ("binning: 4", "spectral_response: ^x.json", "", ["camera.sensor.spectral_response:", "x.json:"]),
    (MASK, "mask: {design: vortex, material: ^glas}", "", ["camera.mask.material:", "'glas'"]),
    (NOISE, "scene_to_camera: ^srgb", "", ["camera.scene_to_camera:", "'srgb'"]),
    (NOISE, "scene_to_camera: [^[1, 2]]", "", ["camera.scene_to_camera[0]:"]),
    # depths
    ("near_cm: 3.6", "near_cm: ^30", "", ["far_cm"]),
    ("depths: 5", "depths: ^0", "", ["1 to 1000"]),
    ("depths: 5", "depths: ^1", "", ["depths_cm"]),
    ("  depths: 5\n", "", "10:1", ["psf:", "depths_cm"]),
    ("far_cm: 20", "far_cm: inf\n  spacing: ^log", "", ["'log'"]),
    ("depths: 5", "depths: 5\n  depths_cm: [4, 5]", "11:12", ["psf.near_cm:", "depths_cm"]),
    (COMPUTED, "  depths_cm: [5, ^4]\n", "", ["psf.depths_cm[1]:"]),
    (COMPUTED, "  depths_cm: [4, 6, ^6]\n", "", ["depths_cm[2]:"]),
    (COMPUTED, "  depths_cm: ^[]\n", "", []),
    (COMPUTED, "  depths_cm: ^5\n", "", []),
    ("depths: 5", "depths: 5\n  accept_error: ^0", "", ["psf.accept_error:"]),
    ("depths: 5", "depths: 5\n  oversampling: ^0", "", ["psf.oversampling:"]),
    ("depths: 5", "depths: 5\n  wavelengths_per_channel: ^0", "", ["1 to 100"]),
    # measured or computed
    (COMPUTED, MEASURED, "4:9", ["camera.mask:", "psf.measured"]),
    (f"  {MASK}\n", "", "3:1", ["camera.mask:", "psf:"]),
    (COMPUTED, f"{MEASURED}  ^near_cm: 3\n", "", ["psf.near_cm:"]),
    ("depths: 5", "depths: 5\n  ^frame: stored", "", ["psf.frame:", "'stored'"]),
    (COMPUTED, MEASURED.replace("[5, inf]", "^[5]"), "", []),
    (COMPUTED, MEASURED.replace("[a.tif, b.tif]", "^[]"), "", []),
    (COMPUTED, MEASURED.replace("  frame: stored\n", ""), "10:1", ["psf.frame:"]),
    (COMPUTED, MEASURED.replace("  throughput_mm2: 2\n", ""), "10:1", ["psf.throughput_mm2:"]),
    # the scene on the sensor
    ("size: [32, 32]", "size: [^33, 32]", "", ["scene.size[0]:"]),
    ("size: [32, 32]", "size: [32, ^98]", "", []),
    ("size: [32, 32]", "size: [^0, 32]", "", ["1 to 32768"]),
    ("size: [32, 32]", "size: ^[32]", "", ["scene.size:"]),
    # counts
    ("binning: 4", "binning: ^0", "", ["1 to 64"]),
    ("[64, 96]", "[^-64, 96]", "", ["camera.sensor.shape[0]:"]),
    ("train: 2", "train: 0", "15:1", ["dataset:"]),
    ("train: 2", "train: 2, workers: ^0", "", ["1 to 1024"]),
    ("train: 2", "train: 2, workers: ^all", "", ["'all'"]),
    ("train: 2", "train: 2, slivers: ^0", "", ["dataset.slivers:"]),
    ("train: 2", "train: 2, ground_truth: ^frame", "", ["'frame'", "'frames'"]),
    ("train: 2", "train: 2, global_measurements: ^1", "", ["dataset.global_measurements:"]),
    ("train: 2", "train: 2, ground_truth: frames, global_measurements: ^true", "", ["ground_truth", "slivers:"]),
    ("seed: 3", "seed: ^-1", "", ["seed:"]),
    ("full_scale: auto", "full_scale: ^0", "", ["1e-15 to 1e+15"]),
    # one of two
    (NOISE, "^noise: {type: gaussian}", "", ["psnr_db"]),
    (NOISE, "noise: {type: gaussian, psnr_db: 4, std: ^0.1}", "", ["psnr_db"]),
    ('family: "./plugins.py:room", ', "", "14:1", ["scene:"]),
    ("path: room.ply", "source: ^x", "", ["scene.source:", "'x'"]),
    # types
    ("mm: 1.9", "mm: ^'1.9'", "", ["'1.9'"]),
    ("mm: 1.9", "mm: ^true", "", []),
    ("_to_sensor_mm: 1.9", "_to_sensor_mm:^", "", ["camera.mask_to_sensor_mm:"]),
    ("seed: 3", "seed: ^3.0", "", []),
    ("name: trial", "name: ^3", "", []),
    ("name: trial", "name: ^''", "", ["name:"]),
    (NOISE, "noise: ^3", "", ["camera.noise:"]),
    (NOISE, "noise: ^{psnr_db: 40}", "", ["'type'"]),
    (NOISE, "noise: {type: ^gausian}", "", ["camera.noise.type:", "'gausian'", "'gaussian'"]),
    ("train: 2", "train: 2, engine: ^locl", "", ["'local'"]),
    (SENSOR, "sensor: ^[64, 96]", "", ["camera.sensor:"]),
    # keys
    ("binning: 4", "^bining: 4", "", ["camera.sensor.bining:", "'binning'"]),
    ("  depths: 5", "  ^depht: 5", "", ["psf.depht:", "'depths'"]),
    ("seed: 3", "^sed: 3", "", ["sed:", "'seed'"]),
    ("seed: 3", "^binning: 3", "", ["binning:", "psf.binning or camera.sensor.binning"]),
    ("seed: 3", "^zzz: 3", "", ["zzz:"]),
    (NOISE, "noise: {type: none, ^std: 0.1}", "", ["camera.noise.std:"]),
    ("output: out, ", "", "15:1", ["dataset.output:"]),
    ("output: out", "^outptu: out", "", ["dataset.outptu:", "'out'", "'output'"]),
    (f"{DATASET}\n", "", "1:1", ["dataset:"]),
    ("size:", "^siz:", "", ["scene.siz:", "'size'"]),
    ("design:", "^desing:", "", ["camera.mask.desing:", "'./plugins.py:mask'", "'design'"]),
    (MASK, "^mask: {}", "", ["camera.mask.design:"]),
    # plugins
    ('"./plugins.py:mask"', '^"./plugins.py:mas"', "", ["camera.mask.design:", "'mas'", "'mask'"]),
    ('"./plugins.py:mask"', '^"./none.py:mask"', "", ["none.py"]),
    ('"./plugins.py:mask"', "^phlatcm", "", ["'phlatcm'", "'phlatcam'"]),
    ('"./plugins.py:room"', "^rooom", "", ["scene.family:", "'rooom'"]),
    ("width_mm: 2", "^width: 2", "", ["camera.mask.width:", "'width_mm'"]),
    ("width_mm: 2", "width_mm: ^21", "", ["camera.mask.width_mm:"]),
    ("width_mm: 2", "kind: ^c", "", ["camera.mask.kind:", "'c'"]),
    ("path: room.ply", "path: ^3", "", ["scene.path:"]),
    ("path: room.ply", "^backend: llvm", "", ["scene.backend:", "'llvm'"]),
    ("path: room.ply", "^view: 1", "", ["scene.view:"]),
]


@pytest.mark.parametrize(("old", "new", "place", "words"), REFUSED, ids=[f"{row[1]!r:.40}" for row in REFUSED])
def test_refused(refused: Callable[..., None], old: str, new: str, place: str, words: list[str]) -> None:
    refused(old, new, place, words)


def test_all_faults_of_a_file_are_listed_from_top_to_bottom(write: Callable[..., Path]) -> None:
    path = write(COMPUTED, "  near_cm: metre\n  far_cm: 20\n  depht: 5\n")
    text = path.read_text("utf-8").replace("seed: 3", "sed: 3").replace("width_mm: 2", "width: 2")
    path.write_text(text.replace("train: 2", "train: -2"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_config(path)
    lines = str(caught.value).splitlines()
    assert [re.sub(r".*trial\.yaml:(\d+):\d+: ([\w.]+): .*", r"\1 \2", line) for line in lines] == [
        "2 sed",
        "4 camera.mask.width",
        "11 psf.near_cm",
        "13 psf.depht",
        "15 dataset.train",
    ]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("far_cm: 20", "far_cm: inf"),
        ("far_cm: 20", "far_cm: .inf"),
        (COMPUTED, "  depths_cm: [5]\n"),
        (COMPUTED, "  depths_cm: [5, 10.5, inf]\n"),
        ("near_cm: 3.6\n  far_cm: 20\n  depths: 5", "near_cm: 20\n  far_cm: 20\n  depths: 1"),
        ("size: [32, 32]", "size: [64, 96]"),
        ("full_scale: auto", "full_scale: 2"),
        (NOISE, "noise: {type: gaussian, std: 1e-3, peak: full_scale, clip: true}"),
        (NOISE, "noise: {type: physical}"),
        ("full_scale: auto", "illuminance_lux: 1000"),
        (SENSOR, "sensor: {shape: [64, 96], binning: 4, readout: bayer}"),
        (f"  {NOISE}\n", ""),
        ("width_mm: 2", "width_mm: 2, kind: b, charge: -1"),
        ("train: 2", "train: 0, test: 1, workers: 3"),
        (GAP, "gap: [{mm: 1.2, n: air}, {mm: 0.7, material: n-bk7}, {mm: 0.1, n: 1.41}]"),
        (GAP, f"{GAP}\n  substrate: {{mm: 0.5, material: fused-silica, side: scene}}"),
        (NOISE, "illuminant: {led_nm: 532, fwhm_nm: 20}"),
        (NOISE, "illuminant: [{led_nm: 455, fwhm_nm: 20}, {led_nm: 532, fwhm_nm: 30, power: 2}]"),
        (NOISE, "scene_to_camera: [[1, 0, 0], [0, 1, 0], [-0.1, 0.1, 1]]"),
        ("binning: 4", "binning: 1, pixel_pitch_um: 2, full_well_e: 10000, spectral_response: Nikon"),
    ],
)
def test_accepted(write: Callable[..., Path], old: str, new: str) -> None:
    load_config(write(old, new))


@pytest.mark.parametrize("files", ["a.tif, b.tif", "all.npy"])
def test_a_measured_psf_needs_no_mask(write: Callable[..., Path], files: str) -> None:
    path = write(COMPUTED, MEASURED.replace("a.tif, b.tif", files) + "  background: dark.tif\n")
    path.write_text(path.read_text("utf-8").replace(f"  {MASK}\n", ""), encoding="utf-8")
    config = load_config(path)
    assert config.camera.mask is None
    assert config.psf.depths_cm == (5.0, float("inf"))
