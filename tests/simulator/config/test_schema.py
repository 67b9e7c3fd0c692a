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
    ("mm: 1.9", "mm: ^532", "", ["camera.mask_to_sensor_mm: got 532; expected 0.05 to 100 mm", "another one?"]),
    ("mm: 1.9", "mm: ^1.9e-3", "", ["got 0.0019; expected 0.05 to 100 mm", "must lie in front of the sensor"]),
    ("mm: 1.9", "mm: ^0", "", ["got 0; ", "must lie in front of the sensor, not on or behind it"]),
    ("mm: 1.9", "mm: ^-1.9", "", ["got -1.9; ", "must lie in front of the sensor"]),
    ("mm: 1.9", "mm: ^.inf", "", ["got inf; expected 0.05 to 100 mm"]),
    ("binning: 4", "pixel_pitch_um: ^2.4e-6", "", ["got 2.4e-06; expected 0.3 to 100 um"]),
    ("binning: 4", "bit_depth: ^3", "", ["expected 4 to 24 bits"]),
    ("binning: 4", "prnu_percent: ^51", "", ["expected 0 to 50 percent"]),
    ("binning: 4", "read_noise_e: ^-1", "", ["expected 0 to 10000 e"]),
    ("exposure_ms: 5", "exposure_ms: ^0", "", ["expected 0.0001 to 100000 ms", "without exposure time"]),
    ("psnr_db: 40", "psnr_db: ^121", "", ["expected 0 to 120 dB"]),
    ("near_cm: 3.6", "near_cm: ^-3.6", "", ["psf.near_cm: got -3.6", "so they are positive"]),
    ("near_cm: 3.6", "near_cm: ^0", "", ["so they are positive"]),
    ("near_cm: 3.6", "near_cm: ^.inf", "", ["expected 0.01 to 1e+07 cm;"]),
    ("near_cm: 3.6", "near_cm: ^0.036", "", ["nearer to the mask than the sensor is (1.9 mm)", "another unit"]),
    (COMPUTED, "  depths_cm: [^0.1, 5]\n", "", ["psf.depths_cm[0]: got 0.1 cm, nearer"]),
    # layers
    (
        GAP,
        "^gap: [{mm: 1, n: air}]\n  mask_to_sensor_mm: 1.9",
        "",
        ["camera.gap: got 1 layers beside mask_to_sensor_mm"],
    ),
    (GAP, "gap: [{mm: 1.2, n: 1}, ^{mm: 0.7}]", "", ["camera.gap[1]: needs exactly one of n", "material, got neither"]),
    (GAP, "gap: [{mm: 1.2, n: ^1.5, material: n-bk7}]", "", ["camera.gap[0].n: needs exactly one", "got both"]),
    (GAP, "gap: [{mm: 1.2, n: ^0.5}]", "", ["camera.gap[0].n: got 0.5; expected 'air' or 1 to 4"]),
    (GAP, "gap: [{mm: 1.2, n: ^water}]", "", ["camera.gap[0].n: got 'water'; expected 'air' or a number"]),
    (GAP, "gap: [{mm: ^0, n: air}]", "", ["camera.gap[0].mm: got 0; expected 0.0001 to 100 mm"]),
    (
        GAP,
        "gap: ^[{mm: 0.01, n: air}, {mm: 0.02, n: 1.5}]",
        "",
        ["camera.gap: got 0.03 mm in all; expected at least 0.05"],
    ),
    (
        GAP,
        f"{GAP}\n  substrate: {{mm: ^36, material: pmma, side: scene}}",
        "",
        ["got 36 mm", "3.6 cm", "lies inside it"],
    ),
    (GAP, "gap: ^[]", "", ["camera.gap: got []; expected at least 1 entries"]),
    (GAP, "gap: [{mm: 1.2, ^nn: air}]", "", ["camera.gap[0].nn: unknown key"]),
    (
        GAP,
        "gap: [{mm: 1.2, material: ^glass}]",
        "",
        ["camera.gap[0].material: got 'glass', expected one of air, fused"],
    ),
    (
        GAP,
        "gap: [{mm: 1.2, material: ^glass.csv}]",
        "",
        ["camera.gap[0].material: cannot read", "glass.csv: No such file"],
    ),
    ("mm: 1.9", "mm: 1.9\n  ^substrate: {mm: 1, material: pmma}", "", ["camera.substrate.side: missing"]),
    (GAP, f"{GAP}\n  substrate: {{mm: 1, material: ^pmm, side: scene}}", "", ["camera.substrate.material: got 'pmm'"]),
    ("mm: 1.9", "mm: 1.9\n  substrate: {mm: 1, material: pmma, side: ^left}", "", ["expected one of scene, sensor"]),
    # light
    (
        NOISE,
        "illuminant: {led_nm: ^5.3e-7, fwhm_nm: 20}",
        "",
        ["camera.illuminant.led_nm: got 5.3e-07", "200 to 2000 nm"],
    ),
    (NOISE, "^illuminant: {led_nm: 532}", "", ["camera.illuminant.fwhm_nm: missing"]),
    (NOISE, "illuminant: [{led_nm: 532, fwhm_nm: ^0.1}]", "", ["camera.illuminant[0].fwhm_nm: got 0.1", "narrower"]),
    (NOISE, "illuminant: ^''", "", ["camera.illuminant: got ''"]),
    (NOISE, "illuminant: ^lamp.csv", "", ["camera.illuminant: cannot read", "lamp.csv: No such file"]),
    (
        "depths: 5",
        "depths: 5\n  as_captured: {illuminant: ^lamp.csv}",
        "",
        ["psf.as_captured.illuminant: cannot read", "lamp.csv: No such file"],
    ),
    (
        "binning: 4",
        "spectral_response: ^x.json",
        "",
        ["camera.sensor.spectral_response: cannot read", "x.json: No such"],
    ),
    (
        MASK,
        "mask: {design: vortex, material: ^glas}",
        "",
        ["camera.mask.material: got 'glas', expected one of air"],
    ),
    (NOISE, "scene_to_camera: ^srgb", "", ["camera.scene_to_camera: got 'srgb'; expected one of auto, identity"]),
    (NOISE, "scene_to_camera: [^[1, 2]]", "", ["camera.scene_to_camera[0]: got [1, 2]; expected at least 3 entries"]),
    # depths
    ("near_cm: 3.6", "near_cm: ^30", "", ["got 30, which is not nearer than far_cm = 20"]),
    ("near_cm: 3.6", "near_cm: ^20", "", ["got 20, which is not nearer than far_cm = 20"]),
    ("depths: 5", "depths: ^0", "", ["got 0; expected 1 to 1000; a stack has at least one plane"]),
    ("depths: 5", "depths: ^1", "", ["one plane is written depths_cm: [z]"]),
    ("depths: 5", "depths: ^5.0", "", ["got 5.0; expected a whole number"]),
    ("  depths: 5\n", "", "10:1", ["psf: the planes are not given", "near_cm, far_cm and depths, or depths_cm"]),
    ("far_cm: 20", "far_cm: inf\n  spacing: ^log", "", ["got 'log', whose even steps never reach", "disparity"]),
    ("depths: 5", "depths: 5\n  depths_cm: [4, 5]", "11:12", ["psf.near_cm: got 3.6 beside depths_cm", "keep one"]),
    (COMPUTED, "  depths_cm: [5, ^4]\n", "", ["psf.depths_cm[1]: got 4 after 5; depths must increase strictly"]),
    (COMPUTED, "  depths_cm: [4, 6, ^6]\n", "", ["depths_cm[2]: got 6 after 6"]),
    (COMPUTED, "  depths_cm: [4, ^-6]\n", "", ["depths_cm[1]: got -6; expected 0.01 to 1e+07 cm or inf"]),
    (COMPUTED, "  depths_cm: ^[]\n", "", ["expected at least 1 entries (there are 0)"]),
    (COMPUTED, "  depths_cm: ^5\n", "", ["got 5; expected a list"]),
    ("depths: 5", "depths: 5\n  accept_error: ^0", "", ["psf.accept_error: got 0"]),
    ("depths: 5", "depths: 5\n  oversampling: ^0", "", ["psf.oversampling: got 0"]),
    ("depths: 5", "depths: 5\n  wavelengths_per_channel: ^0", "", ["got 0; expected 1 to 100"]),
    # measured or computed
    (COMPUTED, MEASURED, "4:9", ["camera.mask: got './plugins.py:mask', but psf.measured says", "keep one"]),
    (f"  {MASK}\n", "", "3:1", ["camera.mask: missing; a PSF is computed from a mask", "psf: {measured: [...]}"]),
    (COMPUTED, f"{MEASURED}  ^near_cm: 3\n", "", ["psf.near_cm: got 3; this key belongs to a computed PSF"]),
    ("depths: 5", "depths: 5\n  ^frame: stored", "", ["psf.frame: got 'stored'; this key belongs to a measured PSF"]),
    (COMPUTED, MEASURED.replace("[5, inf]", "^[5]"), "", ["got 1 depths for 2 files; each picture has one depth"]),
    (COMPUTED, MEASURED.replace("5, inf", "5, ^5"), "", ["psf.depths_cm[1]: got 5 after 5"]),
    (COMPUTED, MEASURED.replace("[a.tif, b.tif]", "^[]"), "", ["expected at least 1 entries"]),
    (COMPUTED, MEASURED.replace("  frame: stored\n", ""), "10:1", ["psf.frame: missing; expected orientation"]),
    (COMPUTED, MEASURED.replace("  throughput_mm2: 2\n", ""), "10:1", ["psf.throughput_mm2: missing; expected light"]),
    # the scene on the sensor
    ("size: [32, 32]", "size: [^33, 32]", "", ["scene.size[0]: got 33 rows on a sensor of 64", "half a pixel"]),
    ("size: [32, 32]", "size: [32, ^31]", "", ["scene.size[1]: got 31 columns on a sensor of 96", "half a pixel"]),
    ("size: [32, 32]", "size: [^66, 32]", "", ["got 66 rows on a sensor of 64", "must not be larger"]),
    ("size: [32, 32]", "size: [32, ^98]", "", ["got 98 columns on a sensor of 96", "must not be larger"]),
    ("size: [32, 32]", "size: [^0, 32]", "", ["got 0; expected 1 to 32768"]),
    ("size: [32, 32]", "size: ^[32]", "", ["scene.size: got [32]; expected at least 2 entries"]),
    ("size: [32, 32]", "size: ^[32, 32, 3]", "", ["at most 2 entries (there are 3)"]),
    ("size: [32, 32]", "size: ^32", "", ["scene.size: got 32; expected a list"]),
    # counts
    ("binning: 4", "binning: ^0", "", ["got 0; expected 1 to 64; 1 means that pixels are not binned"]),
    ("[64, 96]", "[^-64, 96]", "", ["camera.sensor.shape[0]: got -64", "at least one pixel"]),
    ("train: 2", "train: 0", "15:1", ["dataset: train, validation and test are all 0"]),
    ("train: 2", "train: ^-1", "", ["got -1", "not negative"]),
    ("train: 2", "train: 2, workers: ^0", "", ["got 0; expected 'auto' or 1 to 1024"]),
    ("train: 2", "train: 2, workers: ^all", "", ["got 'all'; expected 'auto' or a whole number"]),
    ("train: 2", "train: 2, slivers: ^0", "", ["dataset.slivers: got 0", "one sliver at least"]),
    ("train: 2", "train: 2, slivers: ^2.5", "", ["dataset.slivers: got 2.5"]),
    ("train: 2", "train: 2, ground_truth: ^frame", "", ["got 'frame'; expected one of slivers, frames", "'frames'?"]),
    ("train: 2", "train: 2, global_measurements: ^1", "", ["dataset.global_measurements: got 1"]),
    (
        "train: 2",
        "train: 2, ground_truth: frames, global_measurements: ^true",
        "",
        ["got true beside ground_truth: frames", "belongs to a sliver", "slivers: null"],
    ),
    ("seed: 3", "seed: ^-1", "", ["seed: got -1", "a seed is not negative; 0 is a seed"]),
    ("full_scale: auto", "full_scale: ^0", "", ["got 0; expected 'auto' or 1e-15 to 1e+15"]),
    # one of two
    (NOISE, "^noise: {type: gaussian}", "", ["exactly one of psnr_db and std, got neither"]),
    (NOISE, "noise: {type: gaussian, psnr_db: 4, std: ^0.1}", "", ["exactly one of psnr_db and std, got both"]),
    ('family: "./plugins.py:room", ', "", "14:1", ["scene: needs family: NAME", "or source: NAME"]),
    ("path: room.ply", "source: ^x", "", ["scene.source: got source 'x' beside family", "keep one"]),
    # types
    ("mm: 1.9", "mm: ^'1.9'", "", ["got '1.9'; expected a number"]),
    ("mm: 1.9", "mm: ^true", "", ["got true; expected a number"]),
    ("_to_sensor_mm: 1.9", "_to_sensor_mm:^", "", ["camera.mask_to_sensor_mm: missing", "or give gap"]),
    ("seed: 3", "seed: ^3.0", "", ["got 3.0; expected a whole number"]),
    ("name: trial", "name: ^3", "", ["got 3; expected text"]),
    ("name: trial", "name: ^''", "", ["name: got ''; expected"]),
    (NOISE, "noise: ^3", "", ["camera.noise: got 3; expected a mapping of keys to values"]),
    (NOISE, "noise: ^{psnr_db: 40}", "", ["expected a mapping with the key 'type'"]),
    (NOISE, "noise: {type: ^gausian}", "", ["camera.noise.type: got 'gausian'", "did you mean 'gaussian'?"]),
    ("train: 2", "train: 2, engine: ^locl", "", ["expected one of inline, local", "did you mean 'local'?"]),
    (SENSOR, "sensor: ^[64, 96]", "", ["camera.sensor: got [64, 96]; expected a mapping"]),
    # keys
    ("binning: 4", "^bining: 4", "", ["camera.sensor.bining: unknown key, got 4; expected one of", "'binning'?"]),
    ("  depths: 5", "  ^depht: 5", "", ["psf.depht: unknown key, got 5", "did you mean 'depths'?"]),
    ("seed: 3", "^sed: 3", "", ["sed: unknown key, got 3; expected one of name, seed", "did you mean 'seed'?"]),
    ("seed: 3", "^binning: 3", "", ["binning: unknown key", "did you mean psf.binning or camera.sensor.binning?"]),
    ("seed: 3", "^zzz: 3", "", ["zzz: unknown key, got 3; expected one of name"]),
    (NOISE, "noise: {type: none, ^std: 0.1}", "", ["camera.noise.std: got 0.1; this key belongs to gaussian"]),
    ("output: out, ", "", "15:1", ["dataset.output: missing; expected folder of the data set"]),
    ("output: out", "^outptu: out", "", ["dataset.outptu: unknown key, got 'out'", "did you mean 'output'?"]),
    (f"{DATASET}\n", "", "1:1", ["dataset: missing"]),
    ("family:", "^famly:", "", ["scene.famly: unknown key", "did you mean 'family'?"]),
    ("size:", "^siz:", "", ["scene.siz: unknown key", "did you mean 'size'?"]),
    ("design:", "^desing:", "", ["camera.mask.desing: unknown key, got './plugins.py:mask'", "did you mean 'design'?"]),
    (MASK, "^mask: {}", "", ["camera.mask.design: missing; expected a design's name"]),
    # plugins
    ('"./plugins.py:mask"', '^"./plugins.py:mas"', "", ["camera.mask.design: ", "no function 'mas'", "'mask'?"]),
    ('"./plugins.py:mask"', '^"./none.py:mask"', "", ["there is no file", "none.py"]),
    ('"./plugins.py:mask"', "^phlatcm", "", ["unknown mask design, got 'phlatcm'", "did you mean 'phlatcam'?"]),
    ('"./plugins.py:room"', "^rooom", "", ["scene.family: unknown scene family, got 'rooom'"]),
    ("width_mm: 2", "^width: 2", "", ["camera.mask.width: unknown key, got 2", "did you mean 'width_mm'?"]),
    ("width_mm: 2", "width_mm: ^21", "", ["camera.mask.width_mm: got 21; expected less than or equal to 20"]),
    ("width_mm: 2", "charge: ^2.5", "", ["camera.mask.charge: got 2.5; expected a whole number"]),
    ("width_mm: 2", "kind: ^c", "", ["camera.mask.kind: got 'c'; expected one of a, b"]),
    ("path: room.ply", "path: ^3", "", ["scene.path: got 3; expected text"]),
    ("path: room.ply", "^backend: llvm", "", ["scene.backend: unknown key, got 'llvm'"]),
    ("path: room.ply", "^view: 1", "", ["scene.view: unknown key"]),
]


@pytest.mark.parametrize(("old", "new", "place", "words"), REFUSED, ids=[f"{row[1]!r:.40}" for row in REFUSED])
def test_refused(write: Callable[..., Path], old: str, new: str, place: str, words: list[str]) -> None:
    path = write(old, new.replace("^", ""))
    if "^" in new:
        before = path.read_text("utf-8").partition(new.replace("^", ""))[0] + new.partition("^")[0]
        place = f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message, "one fault, one line"
    assert message.startswith(f"{path}:{place}: "), message
    assert all(word in message for word in words), message


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


def test_one_array_may_hold_the_psfs_of_all_depths(write: Callable[..., Path]) -> None:
    path = write(COMPUTED, MEASURED.replace("a.tif, b.tif", "all.npy"))
    path.write_text(path.read_text("utf-8").replace(f"  {MASK}\n", ""), encoding="utf-8")
    assert load_config(path).psf.depths_cm == (5.0, float("inf"))


def test_a_measured_psf_needs_no_mask(write: Callable[..., Path]) -> None:
    path = write(COMPUTED, f"{MEASURED}  background: dark.tif\n")
    path.write_text(path.read_text("utf-8").replace(f"  {MASK}\n", ""), encoding="utf-8")
    config = load_config(path)
    assert config.camera.mask is None
    assert config.psf.depths_cm == (5.0, float("inf"))
