#!/usr/bin/env bash
# Gathers in one folder all that pip needs to install Flatlight on a machine without internet: docs/offline.md says how.
#
#   bash docs/wheelhouse.sh FOLDER [EXTRA...]          such as: bash docs/wheelhouse.sh wheelhouse learn cloud
#
# The wheels are for this machine's kind: its processor, its Python (python3, or that of .uv where that is there already),
# and a glibc as new as its own or newer.
set -euo pipefail
folder=$(realpath --canonicalize-missing "${1:?usage: bash docs/wheelhouse.sh FOLDER [EXTRA...]}")
extras=("${@:2}")
cd "$(dirname "$0")/.."
[ -x .uv/bin/uv ] || { python3 -m venv .uv && .uv/bin/pip install --quiet uv; }

mkdir -p "$folder"
rm -f "$folder"/flatlight-*.whl
# Versions with hashes: what was copied to the node is checked byte for byte.
.uv/bin/uv export --quiet --no-emit-project --no-header --no-annotate --format requirements-txt \
    "${extras[@]/#/--extra=}" --output-file "$folder/requirements.txt"
.uv/bin/pip download --quiet --no-deps --only-binary :all: --requirement "$folder/requirements.txt" --dest "$folder"
.uv/bin/uv build --quiet --wheel --no-create-gitignore --out-dir "$folder"
hash=$(sha256sum "$folder"/flatlight-*.whl | cut -d ' ' -f 1)
echo "flatlight==$(.uv/bin/uv version --short) --hash=sha256:$hash" >>"$folder/requirements.txt"

echo "$folder: $(du -sh "$folder" | cut -f 1), for $(.uv/bin/python --version) on $(uname -m)"
