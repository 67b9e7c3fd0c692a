"""``masks`` and ``scenes`` as users meet them."""


def test_masks(flatlight) -> None:
    code, out, _ = flatlight("masks")
    assert code == 0
    assert out.startswith("camera.mask.design:")
    for words in ("  phlatcam: ", "  pinhole: ", "  diffusercam: ", "      width_mm: 7.01"):
        assert words in out
    assert "number over 0.05 to 20; side of the square mask" in out


def test_one_mask(flatlight, one_error) -> None:
    code, out, _ = flatlight("masks", "pinhole")
    assert code == 0
    assert "  pinhole: A pinhole" in out
    assert "phlatcam" not in out
    one_error(flatlight("masks", "pinhol"), "unknown mask design, got 'pinhol'", "did you mean 'pinhole'")


def test_scenes(flatlight) -> None:
    code, out, _ = flatlight("scenes")
    assert code == 0
    family, source = out.split("scene.source:")
    assert "  flying_things: " in family
    assert "samples_per_pixel: 16" in family
    assert "  flyingthings3d: " in source
    assert "path: required" in source
    assert "backend" not in out


def test_materials(flatlight) -> None:
    code, out, _ = flatlight("materials")
    assert code == 0
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert "1.51947" in lines["n-bk7"]  # SCHOTT's catalogue at 532 nm
    assert "300-2500" in lines["n-bk7"]
    assert "nominal" in lines["phlatcam-resist"]
    assert ".csv" in out
