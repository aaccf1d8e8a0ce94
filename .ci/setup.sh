# Shared by client/demo.sh and tests/run.sh: installs missing packages, configures and builds.
#
# Source this file with `root` set to the repository's folder and `cpu_minutes` to the minutes that
# a first build (and test) takes on one core. It defines the functions below and `build`, the
# absolute build folder (RAYNEST_BUILD overrides it). It needs only a minimal Debian 12.
# If no package is missing, neither apt nor root is needed. Before an installation it prints the
# cost and, if stdin is a terminal, asks (unless `yes` is 1).

build_packages=(
    g++ cmake ninja-build pkg-config libboost-dev libcli11-dev libdraco-dev libexpected-dev
    libfmt-dev libflatbuffers-dev flatbuffers-compiler libglm-dev libhwy-dev libmeshoptimizer-dev
    libopenimageio-dev libseccomp-dev libspdlog-dev libsqlite3-dev libssl-dev libtbb-dev libtiff-dev libtinygltf-dev
    libtomlplusplus-dev libwebp-dev nlohmann-json3-dev zlib1g-dev
    prometheus-cpp-dev)
test_packages=("${build_packages[@]}" clang-format-14 doctest-dev iproute2 libembree-dev munge nginx openssh-server parallel
    python3 python3-distributed python3-mypy python3-numpy python3-paramiko python3-yaml slurm-wlm xz-utils)

build=${RAYNEST_BUILD:-$root/build}
[[ $build == /* ]] || build=$PWD/$build

fail() { printf 'error: %s\n' "$1" >&2; exit 1; }

# step NAME COMMAND...: runs the command with empty input, and prints how long it took.
step() {
    local name=$1 start=$SECONDS
    shift
    printf '==> %s\n' "$name"
    "$@" </dev/null || fail "$name failed; its output is above"
    printf '    %s: %d s\n' "$name" $((SECONDS - start))
}

# missing_packages NAME...: prints those that dpkg does not list as installed.
missing_packages() {
    local installed name
    installed=" $(dpkg-query -W -f '${db:Status-Abbrev}${Package} ' "$@" 2>/dev/null) "
    for name in "$@"; do
        [[ $installed == *" ii $name "* || $installed == *" hi $name "* ]] || printf '%s ' "$name"
    done
}

# install_missing NAME...: if any is missing: updates the lists, prints the cost, asks, installs.
install_missing() {
    command -v dpkg-query >/dev/null || {
        printf 'This is not a Debian: taking for granted that these are installed: %s\n' "$*"
        return
    }
    local -a missing apt
    read -ra missing <<<"$(missing_packages "$@")"
    ((${#missing[@]})) || return 0

    local remedy="apt-get install --no-install-recommends ${missing[*]}"
    apt=(env DEBIAN_FRONTEND=noninteractive LC_ALL=C apt-get -o DPkg::Lock::Timeout=120
        -o Acquire::Retries=3)
    local -a sudo=()
    if ((EUID != 0)); then
        command -v sudo >/dev/null || fail "neither root nor sudo here; have root run: $remedy"
        sudo=(sudo)
        [[ -t 0 ]] || sudo=(sudo -n)
        "${sudo[@]}" true || fail "sudo was refused; have root run: $remedy"
        apt=("${sudo[@]}" "${apt[@]}")
    fi
    printf 'Not installed yet: %s\n' "${missing[*]}"
    step 'package lists' "${apt[@]}" -qq update

    # Let apt compute the cost. --print-uris only prints; --assume-no would install without a
    # question if no further package is needed. --no-remove: never remove an installed package.
    local plan count download disk minutes
    apt+=(install -y --no-install-recommends --no-remove)
    plan=$("${apt[@]}" --print-uris "${missing[@]}" </dev/null 2>&1) || true
    count=$(sed -n 's/.* \([0-9]*\) newly installed.*/\1/p' <<<"$plan")
    download=$(sed -n 's/^Need to get \([0-9.,]* [kMG]*B\).*/\1/p' <<<"$plan")
    disk=$(sed -n 's/^After this operation, \(.*\) of additional disk.*/\1/p' <<<"$plan")
    [[ $count ]] || { printf '%s\n' "$plan" >&2; fail "apt cannot install them; its reason is above"; }
    minutes=$((1 + count / 120 + cpu_minutes / $(nproc)))
    printf 'To install: %d packages, %s to download, %s on disk.\n' \
        "$count" "${download:-nothing}" "${disk:-nothing}"
    printf 'All of it, the build included, takes about %d minutes on %d cores.\n' \
        "$minutes" "$(nproc)"
    if [[ -t 0 && ${yes:-0} != 1 ]]; then
        local answer
        read -rp 'Install them now? [Y/n] ' answer || answer=no
        [[ ${answer:-y} == [yY]* ]] || fail "not installed; to do it by hand: $remedy"
    fi
    without_services step 'packages' quietly "${apt[@]}" "${missing[@]}"
}

# without_services COMMAND...: meanwhile no package starts a service; a test runs nginx as its own child.
# Packages ask this file before they start one. Uses `sudo` of install_missing.
without_services() {
    local policy=/usr/sbin/policy-rc.d result=0
    [[ ! -e $policy ]] || { "$@"; return; }
    printf '#!/bin/sh\nexit 101\n' | "${sudo[@]}" tee "$policy" >/dev/null
    "${sudo[@]}" chmod 755 "$policy"
    ("$@") || result=$?
    "${sudo[@]}" rm -f "$policy"
    ((result == 0)) || exit "$result"
}

# quietly COMMAND...: shows the command's output only if it fails.
quietly() {
    local log
    log=$(mktemp)
    "$@" >"$log" 2>&1 || { tail -n 40 "$log" >&2; rm -f "$log"; return 1; }
    rm -f "$log"
}

# build_raynest CMAKE_OPTION... -- TARGET...: configures and builds; no target means all of them.
# The cache file is .ci/$config.cmake, or release.cmake if `config` is empty. With the release and
# g++ 12, for which the code is checked, warnings are errors. Both commands use the same options, so
# the second one recompiles nothing. Sanitizers cause warnings of their own.
build_raynest() {
    local -a options=() targets=()
    while (($#)) && [[ $1 != -- ]]; do options+=("$1"); shift; done
    shift
    (($#)) && targets=(--target "$@")
    local strict=OFF
    [[ ! ${config:-} && $("${CXX:-g++}" -dumpversion 2>/dev/null) == 12* ]] && strict=ON
    step 'configure' quietly cmake -S "$root" -B "$build" -G Ninja -C "$root/.ci/${config:-release}.cmake" \
        -DRAYNEST_WERROR=$strict "${options[@]}"
    step 'build' cmake --build "$build" --parallel "$(nproc)" "${targets[@]}"
}
