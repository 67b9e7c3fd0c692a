"""What to install, on this operating system, so that Dr.Jit finds a libLLVM that it can use."""

from __future__ import annotations

import platform
import sys

# Versions that Mitsuba 3.9.0 with Dr.Jit 1.4.0 renders with; 14 and older lack opaque pointers.
LLVM_VERSIONS = range(15, 23)
_ANY = f"any version from {LLVM_VERSIONS.start} to {LLVM_VERSIONS.stop - 1} will do"
# Releases whose archive has 15 but not 19; everything newer has 19.
_OLDER_RELEASES = {("debian", "12"), ("ubuntu", "22.04")}


def how_to_get_llvm(library: str | None) -> str:
    """Return the command that brings a libLLVM here, as one clause without a full stop.

    Args:
        library: the value of DRJIT_LIBLLVM_PATH, if set: Dr.Jit then looks nowhere else.
    """
    if library:
        return f"DRJIT_LIBLLVM_PATH names {library!r}: unset it, or let it name a libLLVM ({_ANY})"
    if sys.platform == "darwin":
        return f"install it with `brew install llvm@20` ({_ANY}) and set DRJIT_LIBLLVM_PATH to its libLLVM.dylib"
    if sys.platform == "win32":
        return f"install LLVM ({_ANY}) and set DRJIT_LIBLLVM_PATH to its LLVM-C.dll"
    return f"install it with `{_linux_command()}` ({_ANY})"


def _linux_command() -> str:
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        release = {}
    family = {release.get("ID", ""), *release.get("ID_LIKE", "").split()}
    if family & {"fedora", "rhel", "centos"}:
        return "sudo dnf install llvm-libs"
    if "arch" in family:
        return "sudo pacman -S llvm-libs"
    if family & {"suse", "opensuse"}:
        return "sudo zypper install libLLVM19"
    older = (release.get("ID", ""), release.get("VERSION_ID", "")) in _OLDER_RELEASES
    return f"sudo apt install libllvm{15 if older else 19}"
