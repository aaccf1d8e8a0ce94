#!/usr/bin/env bash
# Runs the fuzz targets under libFuzzer, AddressSanitizer and UndefinedBehaviorSanitizer.
#   bash tests/fuzz/run.sh [EXECUTIONS [TARGET...]]     default: 100000 of every target
# Needs clang 14 with its runtime (clang, libclang-rt-14-dev). Inputs that reach new code stay in
# build/fuzz/found, so that a later run continues from them; inputs of findings stay there, too.
# Kernels come from the packs of the plain build; tests/conformance tests those.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
executions=${1:-100000}
shift $(($# ? 1 : 0))
plain=${RAYNEST_BUILD:-$root/build}
[[ $plain == /* ]] || plain=$PWD/$plain
build=$plain/fuzz
targets=("$@")
(($#)) || for source in "$root"/tests/fuzz/fuzz_*.cpp; do
    name=${source##*/fuzz_}
    targets+=("${name%.cpp}")
done

[[ -f $plain/build.ninja ]] ||
    cmake -S "$root" -B "$plain" -G Ninja -C "$root/.ci/release.cmake" >/dev/null
cmake --build "$plain" --target raynest_packs
cmake -S "$root" -B "$build" -G Ninja -C "$root/.ci/fuzz.cmake" -DRAYNEST_TESTS=ON >/dev/null
cmake --build "$build" --target "${targets[@]/#/fuzz_}" "${targets[@]/#/replay_}"

status=0
tally=()
for target in "${targets[@]}"; do
    folder=$build/found/$target
    mkdir -p "$folder/corpus"
    "$build/bin/replay_$target" --seeds "$folder/corpus"
    regress=()
    [[ ! -d $root/tests/fuzz/regress/$target ]] || regress=("$root/tests/fuzz/regress/$target")
    printf '==> %s: %s executions\n' "$target" "$executions"
    result=ok
    RAYNEST_BUILTIN_PACKS=$plain/lib/raynest "$build/bin/fuzz_$target" -runs="$executions" \
        -print_final_stats=1 -timeout=120 -rss_limit_mb=4096 -artifact_prefix="$folder/" \
        "$folder/corpus" "${regress[@]}" >"$folder/log" 2>&1 || result=FOUND
    done=$(sed -n 's/^stat::number_of_executed_units: *//p' "$folder/log")
    rate=$(sed -n 's/^stat::average_exec_per_sec: *//p' "$folder/log")
    cover=$(sed -n 's/.* cov: \([0-9]*\).*/\1/p' "$folder/log" | tail -n 1)
    tally+=("$(printf '%-14s %12s executions %8s/s %7s edges  %s' \
        "$target" "${done:-0}" "${rate:-0}" "${cover:-0}" "$result")")
    [[ $result == ok ]] || { status=1; tail -n 60 "$folder/log"; printf 'left in %s\n' "$folder"; }
done
printf '%s\n' "${tally[@]}"
exit "$status"
