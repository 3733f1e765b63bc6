#!/bin/sh
# Installs PyTorch for the CPU: from PyTorch's own index of CPU wheels where that answers, else from the
# configured package index (whose build may bring CUDA with it).
set -eu
python=$1
version=2.13.0
index=${TORCH_INDEX:-https://download.pytorch.org/whl/cpu}
if "$python" -c "import urllib.request as u; u.urlopen('$index/torch/', timeout=5)" 2>/dev/null; then
    "$python" -m pip --disable-pip-version-check --quiet install --no-deps --index-url "$index" "torch==$version"
else
    "$python" -m pip --disable-pip-version-check --quiet install --constraint constraints.txt "torch==$version"
fi
