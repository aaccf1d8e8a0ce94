#!/usr/bin/env bash
# Installs what is missing, builds, runs all tests.
#   bash tests/run.sh [--yes] [--browser] [--sanitize] [--long] [CTEST ARGUMENT...]
# for example: bash tests/run.sh -R wire
# The last line is "N passed, N failed", plus ", N skipped" where some had nothing to run on.
# --browser adds the tests of the page in Chromium, and installs what they need.
# --sanitize builds twice more, beneath build/, and runs the unit and integration tests with the checks
# of .ci/asan.cmake and of .ci/tsan.cmake instead.
# --long adds what is slow and rarely fails: four times as many rays at edges, load tests that go on for
# seconds. Before a release, and after a change to box tests or to the load test.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
yes=0 browser=OFF sanitize=0
while [[ ${1:-} == --yes || ${1:-} == --browser || ${1:-} == --sanitize || ${1:-} == --long ]]; do
    case $1 in
        --yes) yes=1 ;;
        --browser) browser=ON ;;
        --sanitize) sanitize=1 ;;
        --long) export RAYNEST_LONG=1 ;;
    esac
    shift
done
cpu_minutes=70
((!sanitize)) || cpu_minutes=90
# shellcheck source=.ci/setup.sh
source "$root/.ci/setup.sh"

if [[ $browser == ON ]]; then
    for command in chromium:chromium node:nodejs npm:npm; do
        command -v "${command%:*}" >/dev/null || test_packages+=("${command#*:}")
    done
fi
install_missing "${test_packages[@]}"
# Beneath build/, because the tree holds no other project's code; the lock file fixes every byte.
if [[ $browser == ON ]]; then
    mkdir -p "$build/browser"
    cp "$root"/tests/browser/package*.json "$build/browser"
    step 'browser packages' quietly npm ci --prefix "$build/browser" --ignore-scripts --no-audit --no-fund
fi

# run_tests CTEST_ARGUMENT...: those of $build; prints the numbers, fails when one test does.
run_tests() {
    local start=$SECONDS status=0 results=$build/test-results.xml passed skipped total
    printf '==> tests\n'
    rm -f "$results"
    ctest --test-dir "$build" --output-on-failure --no-tests=error --parallel "$(nproc)" \
        --output-junit "$results" "$@" || status=$?
    printf '    tests: %d s\n' $((SECONDS - start))

    # Listing tests (-N) runs none and writes no results.
    [[ -f $results ]] || return "$status"
    passed=$(grep -c '<testcase .*status="run"' "$results" || true)
    skipped=$(grep -c '<skipped message="SKIP_' "$results" || true)
    total=$(grep -c '<testcase ' "$results" || true)
    printf '%d passed, %d failed' "$passed" $((total - passed - skipped))
    ((skipped == 0)) || printf ', %d skipped' "$skipped"
    printf '\n'
    return "$status"
}

# The interpreter that python3-numpy was installed for, whatever else PATH offers.
options=(-DRAYNEST_TESTS=ON -DRAYNEST_BROWSER_TESTS=$browser -DPython3_EXECUTABLE=/usr/bin/python3)
if ((!sanitize)); then
    build_raynest -DRAYNEST_BENCH=ON "${options[@]}" --
    run_tests "$@"
    exit
fi

# The first report ends a program, and with it its test. Not run: what looks at the build, at speed or
# at other compilers' work.
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS="suppressions='$root/tests/leaks.supp':print_suppressions=0"
export RAYNEST_PATIENCE=600
export TSAN_OPTIONS=halt_on_error=1
plain=$build status=0
for config in asan tsan; do
    build=$plain/$config
    printf '==> %s\n' "$config"
    build_raynest "${options[@]}" --
    run_tests --exclude-regex '^(browser|check|demo|readme|own_pack|pack_report|zero_cost|bench)' "$@" ||
        status=$?
done
exit "$status"
