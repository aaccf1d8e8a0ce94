#!/usr/bin/env bash
# Gathers the files that a bare GPU machine without network needs to run driver.py: programs with
# their libraries, packs, arenas and rays, under 96 MiB (a tar.xz of them has a third of that).
#   gather.sh OUT_DIR          then, there: python3 OUT_DIR/driver.py
# RAYNEST_BUILD names the build folder (default: build beside the sources). It must be configured
# with nvcc, RAYNEST_TESTS and RAYNEST_BENCH; missing targets are built. Its
# RAYNEST_CUDA_ARCHITECTURES chooses the GPUs, for example -DRAYNEST_CUDA_ARCHITECTURES=90-real.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../../.." && pwd)
build=${RAYNEST_BUILD:-$root/build}
bytes_max=$((96 << 20))
rays=12288

fail() { printf 'error: %s\n' "$1" >&2; exit 1; }

(($# == 1)) || fail "usage: gather.sh OUT_DIR"
out=$1
[[ ! -e $out || -z $(ls -A "$out") ]] || fail "$out is not empty: name an empty or new folder"
[[ -f $build/CMakeCache.txt ]] || fail "$build is not a build folder: configure or set RAYNEST_BUILD"
cmake --build "$build" --target help | grep -w pack_cuda >/dev/null ||
    fail "$build was configured without CUDA: the configure output says why: 'CUDA: off, ...'"
programs=(raynestd raynest conformance raynest-bench-cuda)
cmake --build "$build" --target pack_cuda raynest_packs raynest-bench-arena "${programs[@]}"

mkdir -p "$out"/{bin,lib/raynest,lib/raynest-cuda,scenes}
cp "$root"/tests/cuda/gpu/{driver,served}.py "$root"/tests/integration/{daemon,npy}.py "$out"
cp "${programs[@]/#/$build/bin/}" "$out/bin"
cp "$build"/lib/raynest/raynest-pack-*.so "$out/lib/raynest"
cp "$build/lib/raynest-cuda/raynest-pack-cuda.so" "$out/lib/raynest-cuda"
# Copies all linked libraries but the C library, which belongs to the machine. Only the image module
# loads OpenImageIO, with hundreds of libraries, and it stays here: pictures are .npy there.
find "$out"/{bin,lib} -type f -exec ldd {} + | awk '$2 == "=>" && $3 ~ /^\// { print $3 }' | sort -u |
    grep -vE '/(libc|libm|libdl|librt|libpthread|libresolv)\.so\.[0-9]+$' | xargs cp -Lt "$out/lib"
find "$out"/{bin,lib} -type f -exec strip --strip-unneeded {} +

# arena NAME SOURCE [KIND...]: scenes/NAME.arena and scenes/NAME-KIND.rays.
export RAYNEST_BUILTIN_PACKS=$build/lib/raynest
arena() {
    local name=$1 source=$2 kinds=()
    shift 2
    for kind; do kinds+=(--rays "$kind=$out/scenes/$name-$kind.rays"); done
    "$build/bin/raynest-bench-arena" "$source" "$out/scenes/$name.arena" --count "$rays" "${kinds[@]}"
}
arena forest builtin:forest primary diffuse
arena trees 'gen:forest1?scale=0.005' primary diffuse
"$build/bin/raynest-bench-arena" 'gen:forest1?scale=0.005' "$out/scenes/trees-flat.arena" --levels 1
arena cards 'gen:cards?scale=0.03' primary diffuse
arena terrain 'gen:terrain?scale=0.01' primary diffuse
arena flake 'builtin:flake?depth=5' primary

total=$(du --summarize --bytes "$out" | cut -f1)
printf '%s: %d MB for GPUs of %s\n' "$out" $((total / 1000000)) \
    "$(sed -n 's/^RAYNEST_CUDA_ARCHITECTURES:[A-Z]*=//p' "$build/CMakeCache.txt")"
((total < bytes_max)) || fail "$out holds $total bytes, at most $bytes_max are allowed"
