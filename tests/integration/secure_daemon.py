"""A daemon with TLS and tokens, and commands that know its CA, for the tests in this folder."""
import os
import pathlib
import subprocess
import sys

from daemon import PATIENCE, Client, Daemon


def command(program, *arguments):
    """Runs a command that must succeed, and returns its output."""
    done = subprocess.run([program, *map(str, arguments)], stdin=subprocess.DEVNULL, text=True,
                          capture_output=True, timeout=PATIENCE)
    if done.returncode != 0:
        raise AssertionError(f"{arguments}: {done.returncode}: {done.stderr}")
    return done.stdout


class Certificates:
    """A folder as `raynestd tls init` makes it."""

    def __init__(self, raynestd, folder, *hosts):
        self.folder = pathlib.Path(folder)
        names = [word for host in hosts for word in ("--host", host)]
        self.said = command(raynestd, "tls", "init", self.folder, *names)
        self.ca = self.folder / "ca.pem"
        self.server = ("--tls-cert", self.folder / "cert.pem", "--tls-key", self.folder / "key.pem")
        self.client = ("--cert", self.folder / "client-cert.pem", "--key",
                       self.folder / "client-key.pem")

    def sign(self, name, subject):
        """Makes a client's certificate, and returns the options that use it. `subject` is in the form of
        openssl's -subj."""
        request, made = self.folder.parent / f"{name}.csr", self.folder.parent / f"{name}.pem"
        key = self.folder / "client-key.pem"
        command("openssl", "req", "-new", "-utf8", "-key", key, "-subj", subject, "-addext",
                "extendedKeyUsage=clientAuth", "-out", request)
        command("openssl", "x509", "-req", "-in", request, "-CA", self.folder / "ca.pem", "-CAkey",
                self.folder / "ca-key.pem", "-days", "9", "-copy_extensions", "copy", "-out", made)
        return "--cert", made, "--key", key

    @staticmethod
    def renew(raynestd, folder):
        command(raynestd, "tls", "renew", folder)


class Tokens:
    def __init__(self, raynestd, file):
        self.raynestd = raynestd
        self.file = pathlib.Path(file)

    def add(self, name, *arguments):
        """Returns the new token."""
        said = command(self.raynestd, "token", "add", name, *arguments, "--tokens", self.file)
        return said.splitlines()[-1]

    def revoke(self, name):
        command(self.raynestd, "token", "revoke", name, "--tokens", self.file)


def fake_ssh(folder, host, port):
    """Writes a program `ssh` that forwards as `ssh -L LOCAL:REMOTE` does, and refuses another host or
    port. It writes its process id, socket and environment into FOLDER/state. Returns its folder, for
    PATH."""
    program = pathlib.Path(folder) / "ssh"
    program.parent.mkdir()
    program.write_text(f"""#!{sys.executable}
import json, os, pathlib, socket, sys, threading
if sys.argv[-2:] != ["--", "{host}"] or "-p" not in sys.argv or sys.argv[sys.argv.index("-p") + 1] != "{port}":
    sys.exit("ssh: Could not resolve hostname " + sys.argv[-1])
here, there = sys.argv[sys.argv.index("-L") + 1].split(":")
state = pathlib.Path(__file__).with_name("state")
state.with_suffix(".new").write_text(json.dumps([os.getpid(), here, dict(os.environ)]))
state.with_suffix(".new").rename(state)
def copy(source, target):
    while data := source.recv(65536):
        target.sendall(data)
    target.shutdown(socket.SHUT_WR)
server = socket.socket(socket.AF_UNIX)
server.bind(here + ".new")
server.listen()
os.rename(here + ".new", here)  # whoever sees it can connect
while True:
    near, far = server.accept()[0], socket.socket(socket.AF_UNIX)
    try:
        far.connect(there)
    except OSError as error:
        print(f"channel 2: open failed: connect failed: {{error.strerror}}", file=sys.stderr, flush=True)
        near.close()
        continue
    for pair in ((near, far), (far, near)):
        threading.Thread(target=copy, args=pair, daemon=True).start()
""")
    program.chmod(0o755)
    return program.parent


class SecureClient(Client):
    """Runs `raynest` with a CA and a token, and knows no others."""

    def __init__(self, program, uri, ca=None, token=None, home="/nonexistent"):
        super().__init__(program, uri)
        self.environment = {"RAYNEST_SERVER": uri, "HOME": str(home), "XDG_CONFIG_HOME": "",
                            "RAYNEST_RECONNECT": "0"}
        if ca:
            self.environment["RAYNEST_CA"] = str(ca)
        if token:
            self.environment["RAYNEST_TOKEN"] = token

    def start(self, *arguments, **options):
        inherited = {name: value for name, value in os.environ.items()
                     if not name.startswith("RAYNEST_") or name == "RAYNEST_BUILTIN_PACKS"}
        options.setdefault("stdin", subprocess.DEVNULL)
        return subprocess.Popen([self.program, *map(str, arguments)],
                                env=inherited | self.environment, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True, errors="replace", **options)


class SecureDaemon(Daemon):
    """Listens on TLS too; `tls` is that address."""

    def __init__(self, raynestd, certificates, *arguments, host="127.0.0.1", under=()):
        super().__init__(raynestd, "--listen", f"tls://{host}:0", *certificates.server,
                         *arguments, under=under)
        self.tls = next(uri for uri in self.listen if uri.startswith("tls://"))
        self.port = int(self.tls.rsplit(":", 1)[1])
