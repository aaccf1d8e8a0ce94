#!/usr/bin/env bash
# Measures every row that the table of the README is made of, and prints it.
#   run_table.sh [ROWS.jsonl] [OPTION OF raynest-bench...]     e.g. run_table.sh v3.jsonl --target v3
# RAYNEST_BUILD names the build folder (default: build beside the sources). About eight minutes on one
# core; laps with somebody else on the core are left out, and more are run instead.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
build=${RAYNEST_BUILD:-$root/build}
rows=${1:-bench-rows.jsonl}
(($# == 0)) || shift
options=("$@")
target=v4
for ((i = 0; i + 1 < ${#options[@]}; ++i)); do
    [[ ${options[i]} != --target ]] || target=${options[i + 1]}
done
export RAYNEST_BUILTIN_PACKS=${RAYNEST_BUILTIN_PACKS:-$build/lib/raynest}

# bench ARGUMENT...: adds its rows. 9 says that answers differ more than edges explain: the rows hold
# how many, the table lists them, and what was measured stays.
bench() {
    local status=0
    "$build/bin/raynest-bench" --json "$@" "${options[@]}" >>"$rows" || status=$?
    ((status == 0 || status == 9)) || exit "$status"
}

: >"$rows"
kinds=primary,diffuse,random,shadow,ao
for scene in terrain cards interior; do
    bench --scene "gen:$scene" --rays "$kinds" \
        --peers embree,embree-coherent,embree-robust
    bench --scene "gen:$scene" --build --quality medium --rounds 3 --threads 1,2 --peers embree
done
bench --scene gen:cards --rays "$kinds" --intersector alpha_mask --traversal auto \
    --peers embree-filter,embree-filter-coherent,embree-argument
bench --scene gen:cards --rays primary,diffuse,random --kind multi --max-hits 8 \
    --traversal auto --peers embree-list,embree-shrink
bench --scene gen:forest1 --rays primary,diffuse,ao --traversal auto --peers embree,embree-coherent
bench --scene gen:forest3 --over gen:forest3-flat --rays primary,diffuse,ao --traversal auto,single
bench --scene gen:forest3-flat --build --peers embree
bench --scene gen:terrain --rays primary,diffuse --traversal single --threads 1,2 --peers own
for scene in terrain cards forest3; do
    for traversal in single auto; do
        bench --scene "gen:$scene" --rays primary,diffuse \
            --traversal "$traversal" --counters none,total,level --peers own
    done
done
bench --scene gen:cards --rays primary,diffuse --traversal single \
    --intersector alpha_mask --counters none,total,level --peers own
bench --scene gen:cards --rays primary,diffuse,ao --traversal single \
    --intersector no_test,pointer_null,pointer_noop --peers own
bench --scene gen:cards --rays primary,diffuse,ao --traversal single \
    --intersector fused_alpha,pointer_alpha --peers own
python3 "$root/tests/bench/table.py" --target "$target" "$rows"
