#!/usr/bin/env python3
"""Makes the Debian packages, checks them with lintian, and installs, upgrades, removes and purges them on
a fresh Debian 12. Root only, of tests/run.sh --long; else skipped.

  package_test.py SOURCE_DIR BUILD_DIR CMAKE
"""
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE, BUILD, CMAKE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]
FRESH = SOURCE / "../shared/tools/fresh-machine"
# Files that dpkg, apt and adduser write about themselves.
OWN_FILES = re.compile(r"^/(var/(log|cache|lib/(dpkg|apt|systemd|ucf|pam|python))|tmp|proc|sys|dev|run|root|"
                       r"etc/(ld\.so\.cache|passwd-?|group-?|shadow-?|gshadow-?|subuid-?|subgid-?))")
PACK = {
    "CMakeLists.txt": """cmake_minimum_required(VERSION 3.22)
project(outside LANGUAGES CXX)
set(CMAKE_BUILD_TYPE Release)
find_package(raynest 0.1 REQUIRED COMPONENTS engine)
raynest_kernel_pack(own-pack TARGET v2 INTERSECTORS intersectors.def)
add_executable(embedder embedder.cpp)
target_compile_definitions(embedder PRIVATE PACKS="${raynest_PACK_DIR}")
target_link_libraries(embedder PRIVATE raynest::engine)
""",
    "intersectors.def": "RAYNEST_INTERSECTOR(every_second, EverySecond, primitives)\n",
    "every_second.h": """#pragma once
#include "engine/intersectors/interface.h"
namespace raynest {
struct EverySecond {
    static constexpr const char* text = "every second triangle is not there";
    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        auto hits = intersect(ray, primitive);
        hits.keep_if([](const Surface& hit) { return hit.prim % 2 == 0; });
        return hits;
    }
};
}  // namespace raynest
""",
    "embedder.cpp": """#include "engine/assets/builtin/builtin.h"
#include "engine/assets/import.h"
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include <cstdio>
#include <cstdlib>
using namespace raynest;
int main() {
    setenv("RAYNEST_BUILTIN_PACKS", PACKS, 0);
    const auto registry = Registry::load({});
    if (!registry) return std::puts(registry.error().message.c_str()), 1;
    ImportRequest request;
    request.source = "builtin:terrain?size=8";
    const auto scene = import_here(request, ImportLimits{}, **registry, describe_builtin);
    if (!scene) return std::puts(scene.error().message.c_str()), 1;
    const auto variant = (*registry)->choose("auto", (*scene)->view());
    const auto trace = find_function(**variant, query_closest, traversal_single);
    const Ray ray{{0, 90, 0}, 0, {0, -1, 0}, 1000};
    HitRecord hit{};
    TraceCall call{};
    call.scene = &(*scene)->view();
    call.rays = &ray;
    call.ray_count = 1;
    call.hits_max = 1;
    call.mask = ~0U;
    call.hits = &hit;
    if ((*trace)(&call) != trace_ok) return 2;
    std::printf("%s %d\\n", (*variant)->name.c_str(), hit.hit);
}
""",
}

# Runs as a unit of its own once the machine is up; each step says its name and its exit code.
PROBE = """#!/bin/sh
exec >/opt/probe.log 2>&1
export RAYNEST_SERVER=unix:/run/raynest/socket
step() { name=$1; shift; "$@"; echo "STEP $name $?"; }
as() { user=$1; shift; setpriv --reuid=$user --regid=$user --init-groups "$@"; }
useradd -G raynest one; useradd -G raynest other
step activated raynest scenes
step load raynest load builtin:forest?trees=9 --name woods
step no_pictures raynest render woods --size 64x64 -o /tmp/a.png
step restart systemctl restart raynestd.service
step after_restart raynest scenes
kill -9 $(systemctl show -p MainPID --value raynestd)
step after_kill raynest --reconnect 20 scenes
step own as one raynest load builtin:terrain?size=8 --name secret
step of_another as other raynest unload secret
step reload systemctl reload raynestd.service
step still_there as one raynest unload secret
echo "thrads = 3" >>/etc/raynest/raynestd.toml
step bad_reload systemctl reload raynestd.service
sed -i '$d' /etc/raynest/raynestd.toml

# A removed package starts again after its installation.
dpkg -r raynest
step left_by_remove ls -A /run/raynest
step reinstall dpkg -i /opt/raynest.deb
step enabled systemctl is-enabled raynestd.socket raynestd.service
step started systemctl is-active raynestd.socket raynestd.service

# The commands of OPERATING.md under "Secure", "Revoke" and "Renew".
step tls raynestd tls init /etc/raynest/tls --host gpu.example.org
raynestd token add alice --role user --expires 90d --tokens /etc/raynest/tokens >/opt/token; echo "STEP token $?"
(cd /etc/raynest && chgrp raynest tls tls/ca.pem tls/cert.pem tls/key.pem tokens &&
 chmod g+rX tls tls/ca.pem tls/cert.pem tls/key.pem tokens)
sed -i 's/^#   "tls/    "tls/; s/^# \\(tls-cert\\|tls-key\\|tokens\\)/\\1/' /etc/raynest/raynestd.toml
mkdir /etc/systemd/system/raynestd.socket.d
printf '[Socket]\nListenStream=0.0.0.0:31062\n' >/etc/systemd/system/raynestd.socket.d/override.conf
systemctl daemon-reload
step secured systemctl restart raynestd.socket
export RAYNEST_SERVER=tls://127.0.0.1:31062 HOME=/opt
tail -n 1 /opt/token | step login raynest --ca /etc/raynest/tls/ca.pem login $RAYNEST_SERVER
step query raynest query builtin:terrain?size=8 --ray 0,50,0,0,-1,0
step revoke raynestd token revoke alice --tokens /etc/raynest/tokens
sleep 1
step refused raynest scenes
step renew raynestd tls renew /etc/raynest/tls
step renewed systemctl reload raynestd.service
journalctl --no-pager -o cat -u raynestd
echo ERRORS; journalctl --no-pager -o cat -p err _COMM=raynestd; echo END

# Keys that stay root's, a hook that copies renewed ones, and scenes at the start.
chown root: /etc/raynest/tls/*
mkdir -p /srv/scenes /etc/systemd/system/raynestd.service.d
echo broken >/srv/scenes/broken.gltf
sed -i '/^tls-/d; s|^# load = .*|load = ["/srv/scenes/*.gltf", "builtin:terrain?size=8"]|' /etc/raynest/raynestd.toml
sed -n '/^LoadCredential=/p; /^Environment=RAYNEST/p; /^ExecReload=/p' /usr/share/doc/raynest/OPERATING.md |
    sed '1i [Service]' | sed 's|/etc/letsencrypt/live/gpu.example.org/privkey|/etc/raynest/tls/key|;
                             s|/etc/letsencrypt/live/gpu.example.org/fullchain|/etc/raynest/tls/cert|' \
    >/etc/systemd/system/raynestd.service.d/override.conf
systemctl daemon-reload
step credentials systemctl restart raynestd.service
raynestd token add bob --tokens /etc/raynest/tokens | tail -n 1 >/opt/token
sleep 2
RAYNEST_TOKEN=$(cat /opt/token) step loaded raynest --ca /etc/raynest/tls/ca.pem query terrain --ray 0,50,0,0,-1,0
step credentials_reload systemctl reload raynestd.service
systemctl is-active raynestd.service
dpkg -P raynest
step purged sh -c 'test -z "$(ls -d /run/raynest /etc/raynest /var/lib/raynest)"'
systemctl poweroff
"""
PROBE_UNIT = """[Unit]
After=multi-user.target
[Service]
Type=oneshot
ExecStart=/opt/probe.sh
[Install]
WantedBy=multi-user.target
"""


def run(*command, good=(0,), **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True,
                          stdin=subprocess.DEVNULL, check=False, **options)
    if done.returncode not in good:
        raise AssertionError(f"{command} gave {done.returncode}:\n{done.stdout[-4000:]}"
                             f"{done.stderr[-4000:]}")
    return done.stdout


class Root:
    """The root folder of a fresh Debian."""

    def __init__(self):
        self.environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8",
                            "HOME": "/root", "DEBIAN_FRONTEND": "noninteractive",
                            **{name: value for name, value in os.environ.items()
                               if name.lower().endswith("_proxy")}}
        kept = run(FRESH, "-k", "true", cwd=SOURCE)
        self.path = pathlib.Path(re.search(r"kept: (\S+)", kept)[1])

    def run(self, command, good=(0,)):
        """Runs a line of the shell in it, with processes and mounts of its own."""
        script = ('mount -t proc proc "$0/proc" && mount --bind /dev "$0/dev" && '
                  'mount -t tmpfs tmpfs "$0/dev/shm" && exec chroot "$0" sh -ec "$1"')
        return run("unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", script,
                   self.path, command, good=good, env=self.environment)

    def files(self):
        """All files and folders, but for those of the package tools themselves."""
        found = self.run("find / -xdev -not -path '/home/*' -print").splitlines()
        return {path for path in found if not OWN_FILES.match(path)}

    def remove(self):
        shutil.rmtree(self.path, ignore_errors=True)


class Package(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        for program in ("debootstrap", "lintian", "unshare", "dpkg-shlibdeps"):
            if not shutil.which(program):
                raise unittest.SkipTest(f"skipped: there is no {program}")
        cls.folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        run(CMAKE, "--build", BUILD, "--target", "raynestd", "raynest", "raynest_packs",
            "raynest_images", "raynest_draco", "manual")
        run("cpack", "-G", "DEB", "-B", cls.folder, cwd=BUILD)
        cls.debs = sorted(cls.folder.glob("*.deb"))

    def test_there_are_three_without_errors_of_lintian(self):
        self.assertEqual([deb.name.split("_")[0] for deb in self.debs],
                         ["libraynest-dev", "python3-raynest", "raynest"])
        told = run("lintian", "--fail-on", "none", *self.debs)
        self.assertEqual([line for line in told.splitlines() if line.startswith("E:")], [])

    def later(self, deb):
        """Returns a copy of a package with a later version."""
        tree = self.folder / "later"
        shutil.rmtree(tree, ignore_errors=True)
        run("dpkg-deb", "-R", deb, tree)
        control = tree / "DEBIAN/control"
        control.write_text(re.sub(r"(?m)^Version: (.*)$", r"Version: \1+later", control.read_text()))
        made = self.folder / "later.deb"
        run("dpkg-deb", "--root-owner-group", "-b", tree, made)
        return made

    def test_it_installs_works_upgrades_and_leaves_nothing(self):
        root = Root()
        self.addCleanup(root.remove)
        root.run("apt-get update -qq")
        # The libraries stay on the machine: only the package itself must leave nothing.
        raynest = next(deb for deb in self.debs if deb.name.startswith("raynest_"))
        depends = run("dpkg-deb", "-f", raynest, "Depends")
        depends += "," + run("dpkg-deb", "-f", raynest, "Recommends")
        names = " ".join(re.sub(r"\(.*?\)|\|.*", "", part).strip() for part in depends.split(","))
        root.run(f"apt-get install -y -qq --no-install-recommends {names} python3-numpy")
        before = root.files()
        for deb in (*self.debs, self.later(raynest)):
            shutil.copy(deb, root.path / "tmp")
        said = root.run("apt-get install -y -qq --no-install-recommends /tmp/raynest_*.deb "
                        "/tmp/python3-raynest_*.deb 2>&1")
        print(said[-1500:], file=sys.stderr)
        self.assertIn("raynest:", root.run("getent passwd raynest; getent group raynest"))
        self.check_it_runs(root)

        root.run("echo '# mine' >>/etc/raynest/raynestd.toml")
        print(root.run("dpkg -i /tmp/later.deb 2>&1")[-800:], file=sys.stderr)
        self.assertIn("+later", root.run("dpkg-query -W -f '${Version}' raynest"))
        self.assertIn("# mine", root.run("cat /etc/raynest/raynestd.toml"))
        self.check_it_runs(root)

        root.run("dpkg -r python3-raynest raynest")
        self.assertIn("# mine", root.run("cat /etc/raynest/raynestd.toml"))
        print(root.run("dpkg -P raynest 2>&1")[-800:], file=sys.stderr)
        self.assertEqual(root.run("getent passwd raynest || true; getent group raynest || true"), "")
        self.assertEqual(sorted(root.files() - before), [])

    def check_it_runs(self, root):
        """Starts the daemon as its unit does, asks it, and stops it."""
        told = root.run(
            "install -d -o raynest -g raynest -m 0750 /run/raynest; "
            "install -d -o raynest -g raynest -m 0700 /var/lib/raynest; "
            "raynestd --config /etc/raynest/raynestd.toml --check-config >&2; "
            "setpriv --reuid=raynest --regid=raynest --clear-groups --no-new-privs "
            "raynestd --config /etc/raynest/raynestd.toml 2>/tmp/log & daemon=$!; "
            "for i in $(seq 100); do raynest --server unix:/run/raynest/socket scenes >/dev/null 2>&1 && "
            "break; sleep 0.1; done; "
            "export RAYNEST_SERVER=unix:/run/raynest/socket; "
            "raynest load builtin:forest?trees=9 --name woods >&2; "
            "raynest --json query woods --ray 8,50,-8,0,-1,0; "
            "raynest render woods --size 64x64 -o /tmp/a.png >&2; "
            "python3 -c \"import raynest; print(len(raynest.connect().scenes()))\"; "
            "kill $daemon; wait $daemon || true")
        lines = told.splitlines()
        self.assertIn("hits", json.loads(lines[0]))
        self.assertEqual(lines[1], "1")
        root.run("rm -rf /tmp/a.png /tmp/log /run/raynest $HOME/.config")

    def test_the_unit_runs_under_systemd(self):
        if not shutil.which("systemd-nspawn"):
            self.skipTest("there is no systemd-nspawn")
        root = Root()
        self.addCleanup(root.remove)
        shutil.copy(next(deb for deb in self.debs if deb.name.startswith("raynest_")), root.path / "opt/raynest.deb")
        root.run("apt-get update -qq; apt-get install -y -qq --no-install-recommends systemd systemd-sysv dbus "
                 "passwd /opt/raynest.deb")
        (root.path / "opt/probe.sh").write_text(PROBE)
        (root.path / "opt/probe.sh").chmod(0o755)
        (root.path / "etc/systemd/system/probe.service").write_text(PROBE_UNIT)
        (root.path / "etc/machine-id").write_text("")
        # While it waits for a console, the child of systemd that becomes a getty holds the sockets of others.
        (root.path / "etc/systemd/system/console-getty.service").symlink_to("/dev/null")
        root.run("systemctl enable probe.service raynestd.socket")
        run("systemd-nspawn", "--register=no", "--keep-unit", "--private-network", "--quiet", "--boot",
            "--directory", root.path, timeout=300)
        told = (root.path / "opt/probe.log").read_text()
        steps = dict(line.split()[1:] for line in told.splitlines() if line.startswith("STEP "))
        good = ("activated load restart after_restart after_kill own reload still_there reinstall enabled started "
                "tls token secured login query revoke renew renewed credentials loaded credentials_reload purged")
        self.assertEqual(steps, {**dict.fromkeys(good.split(), "0"), "of_another": "5", "refused": "4",
                                 "no_pictures": "5", "bad_reload": "1", "left_by_remove": "2"}, told)
        self.assertRegex(told, r" reloaded ")
        errors = re.search(r"ERRORS\n(.*?)END\n", told, re.S)[1].splitlines()
        self.assertTrue(errors and all(line.startswith("raynestd: ") for line in errors), errors)

    def test_a_pack_and_a_program_build_against_the_development_package(self):
        root = Root()
        self.addCleanup(root.remove)
        for deb in self.debs:
            shutil.copy(deb, root.path / "tmp")
        root.run("apt-get update -qq; apt-get install -y -qq --no-install-recommends g++ cmake make "
                 "/tmp/libraynest-dev_*.deb /tmp/raynest_*.deb "
                 f"{run('dpkg-deb', '-f', self.debs[0], 'Recommends').replace(', raynest', '').replace(',', ' ')}")
        project = root.path / "tmp/outside"
        project.mkdir()
        for name, text in PACK.items():
            (project / name).write_text(text)
        root.run("cd /tmp/outside; cmake -B build -S . >&2; cmake --build build >&2")
        self.assertEqual(root.run("/tmp/outside/build/embedder"), "opaque 1\n")
        told = root.run(
            "raynestd --pack-dir /tmp/outside/build --listen unix:/tmp/s --http off --log-level error & daemon=$!; "
            "for i in $(seq 100); do raynest --server unix:/tmp/s scenes >/dev/null 2>&1 && break; "
            "sleep 0.1; done; export RAYNEST_SERVER=unix:/tmp/s; raynest variants; "
            "raynest load builtin:terrain?size=8 >&2; "
            "raynest --json query terrain --ray 0,50,0,0,-1,0 --intersector every_second; kill $daemon; wait $daemon || true")
        self.assertIn("every_second", told)


if __name__ == "__main__":
    if "RAYNEST_LONG" not in os.environ or os.geteuid() != 0 or not FRESH.exists():
        print("skipped: of tests/run.sh --long, as root, with ../shared/tools/fresh-machine",
              file=sys.stderr)
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
