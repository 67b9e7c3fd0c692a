"""``masks`` and ``scenes`` as users meet them."""


def test_masks(flatlight) -> None:
    code, out, _ = flatlight("masks")
    assert code == 0
    assert out.startswith("camera.mask.design:")
    for words in ("  phlatcam: ", "  pinhole: ", "  diffusercam: ", "      width_mm: 7.01"):
        assert words in out


def test_scenes(flatlight) -> None:
    code, out, _ = flatlight("scenes")
    assert code == 0
    family, source = out.split("scene.source:")
    assert "  flying_things: " in family
    assert "samples_per_pixel: 16" in family
    assert "  flyingthings3d: " in source
    assert "path: required" in source
    assert "backend" not in out
