#!/usr/bin/env bash
# Installs what is missing, builds, runs all tests.
#   bash tests/run.sh [--yes] [CTEST ARGUMENT...]      for example: bash tests/run.sh -R wire
# The last line is "N passed, N failed", plus ", N skipped" where some had nothing to run on.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
yes=0
[[ ${1:-} != --yes ]] || { yes=1; shift; }
cpu_minutes=20
# shellcheck source=.ci/setup.sh
source "$root/.ci/setup.sh"

install_missing "${test_packages[@]}"
# The interpreter that python3-numpy was installed for, whatever else PATH offers.
build_raynest -DRAYNEST_TESTS=ON -DRAYNEST_BENCH=ON -DPython3_EXECUTABLE=/usr/bin/python3 --

printf '==> tests\n'
start=$SECONDS status=0 results=$build/test-results.xml
rm -f "$results"
ctest --test-dir "$build" --output-on-failure --no-tests=error --parallel "$(nproc)" \
    --output-junit "$results" "$@" || status=$?
printf '    tests: %d s\n' $((SECONDS - start))

# Listing tests (-N) runs none and writes no results.
if [[ -f $results ]]; then
    passed=$(grep -c '<testcase .*status="run"' "$results" || true)
    skipped=$(grep -c '<skipped message="SKIP_' "$results" || true)
    total=$(grep -c '<testcase ' "$results" || true)
    failed=$((total - passed - skipped))
    printf '%d passed, %d failed' "$passed" "$failed"
    ((skipped == 0)) || printf ', %d skipped' "$skipped"
    printf '\n'
fi
exit "$status"
