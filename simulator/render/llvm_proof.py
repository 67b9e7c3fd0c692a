"""A script of its own: asks Dr.Jit for LLVM and renders a few pixels with it, reporting each step as one JSON line.

It runs in a subprocess because an unsuitable libLLVM does not raise but aborts the whole process.
"""

import json


def _report(**facts: object) -> None:
    print(json.dumps(facts), flush=True)


def prove() -> None:
    """Report the version of libLLVM, then the mean of a picture of a half-white wall in uniform light: 0.5."""
    import drjit as dr

    _report(found=bool(dr.has_backend(dr.JitBackend.LLVM)), version=list(dr.detail.llvm_version()))
    import mitsuba as mi
    import numpy as np

    mi.set_variant("llvm_ad_rgb")
    box_film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {"type": "perspective", "film": box_film},
            "light": {"type": "constant", "radiance": 1.0},
            "wall": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(10),
                "bsdf": {"type": "diffuse", "reflectance": 0.5},
            },
        }
    )
    _report(mean=float(np.mean(np.asarray(mi.render(scene, spp=16)))))


if __name__ == "__main__":
    prove()
