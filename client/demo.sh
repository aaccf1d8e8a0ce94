#!/usr/bin/env bash
# Shows RayNest: installs what is missing, builds, starts a daemon of its own on a free port, draws
# one scene four ways into demo-out/, asks for one ray, and stops the daemon again.
#   bash client/demo.sh [--yes] [--open] [SOURCE]
#     SOURCE   builtin:forest (default), another builtin:..., or a .glb or .gltf file
#     --yes    install without asking
#     --open   keep the daemon until Ctrl-C, and show its page or print the page's address
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
yes=0 open=0 source=builtin:forest
for argument in "$@"; do
    case $argument in
        --yes) yes=1 ;;
        --open) open=1 ;;
        -h | --help) sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"; exit 0 ;;
        -*) sed -n '2,/^set/s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 2 ;;
        *) source=$argument ;;
    esac
done
cpu_minutes=17
# shellcheck source=.ci/setup.sh
source "$root/.ci/setup.sh"

# Without --open nobody needs a page, so the default port stays free for others.
page=off
((!open)) || page=127.0.0.1:0
# forest of builtin:forest?trees=9, cocoa of scenes/cocoa.glb.
scene=${source##*/} scene=${scene#builtin:} scene=${scene%%\?*} scene=${scene%.*}
daemon='' scratch=$(mktemp -d)
# End the daemon when the script ends: by SIGTERM, then by SIGKILL.
finish() {
    if [[ $daemon ]]; then
        kill "$daemon" 2>/dev/null || true
        for _ in {1..50}; do
            kill -0 "$daemon" 2>/dev/null || break
            sleep 0.1
        done
        kill -KILL "$daemon" 2>/dev/null || true
        wait "$daemon" 2>/dev/null || true
    fi
    rm -rf "$scratch"
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP

start_daemon() {
    "$build/bin/raynestd" --listen tcp://127.0.0.1:0 --http "$page" \
        --ready-file "$scratch/ready.json" >"$scratch/raynestd.log" 2>&1 &
    daemon=$!
    for _ in {1..300}; do
        [[ ! -s $scratch/ready.json ]] || break
        kill -0 "$daemon" 2>/dev/null || break
        sleep 0.1
    done
    [[ -s $scratch/ready.json ]] || { cat "$scratch/raynestd.log" >&2; return 1; }
    RAYNEST_SERVER=$(grep -o 'tcp://[^"]*' "$scratch/ready.json")
    export RAYNEST_SERVER
}

# draw FILE TITLE COMMAND...: one picture; the client says how many rays it took and how fast.
draw() {
    local file=$1 title=$2 command=$3
    shift 3
    printf '    %s\n' "$title"
    "$raynest" "$command" "$scene" -o "$pictures/$file" "$@" | sed "s/^/      /"
}

# Trace some rays straight down and show the one that hits highest: a crown rather than the ground.
# Its path id names, in one number, the instances that the ray went through.
ask_one_ray() {
    local -a rays=()
    local along hit
    for along in -31 -17 -11 -5 5 11 17 31; do rays+=(--ray "$along,10000,$along,0,-1,0"); done
    hit=$("$raynest" --json query "$scene" "${rays[@]}" | sed -n 's/.*"t":\([^,}]*\).*/\1 &/p' |
        LC_ALL=C sort -g | head -n 1)
    [[ $hit ]] || { printf '    none of the rays hits anything\n'; return; }
    printf '    %s\n' "${hit#* }"
    hit=${hit##*\"path\":}
    printf '    path %s is %s\n' "${hit%%[,\}]*}" "$("$raynest" path "$scene" "${hit%%[,\}]*}")"
}

install_missing "${build_packages[@]}"
# A build folder that the tests already use keeps its tests.
options=()
[[ -f $build/CMakeCache.txt ]] || options=(-DRAYNEST_TESTS=OFF -DRAYNEST_BENCH=OFF)
build_raynest "${options[@]}" -- raynestd raynest raynest_packs_here
raynest=$build/bin/raynest pictures=${RAYNEST_DEMO_OUT:-$root/demo-out}
mkdir -p "$pictures"

step 'daemon' start_daemon
printf '==> scene: %s\n' "$source"
"$raynest" load "$source" --name "$scene" | sed 's/^/    /'
printf '==> pictures\n'
draw opaque.png 'mask ignored' render --intersector opaque
draw alpha_mask.png 'alpha mask' render --intersector alpha_mask
draw procedural_mask.png 'procedural mask' render --intersector procedural_mask
draw path.png 'lit by sun and sky, 8 samples per pixel' render --integrator path --spp 8
draw heat.png 'heat map: boxes and triangles tested per pixel, alpha mask' \
    heatmap --intersector alpha_mask
printf '==> one ray\n'
ask_one_ray

printf '\nThe pictures:\n'
printf '  %s\n' "$pictures"/{opaque,alpha_mask,procedural_mask,path,heat}.png
if ((open)); then
    printf '\nThe page, until Ctrl-C:\n'
    "$raynest" open "$scene"
    wait "$daemon"
    exit
fi
printf '\nTo go on, type:\n'
printf '  %q &\n' "$build/bin/raynestd"
printf '  %q load %q --name %q\n' "$raynest" "$source" "$scene"
printf '  %q render %q --intersector procedural_mask --set pattern=heart -o hearts.png\n' \
    "$raynest" "$scene"
