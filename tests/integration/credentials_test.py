#!/usr/bin/env python3
"""Tests the files of an administrator: `raynestd token` and `raynestd tls`, and files that cannot be used.

  credentials_test.py RAYNESTD RAYNEST
"""
import os
import pathlib
import resource
import shutil
import signal
import stat
import subprocess
import tempfile
import unittest

from daemon import PATIENCE, Programs, main, until
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens
from tls_test import openssl

DAY = 86400
OTHER = 12345  # a user that this machine need not have


class Credentials(Programs):
    def setUp(self):
        self.out = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.tokens = Tokens(self.raynestd, self.out / "tokens")

    def certificates(self, name="tls"):
        return Certificates(self.raynestd, self.out / name)

    def does(self, code, says, *arguments, **options):
        """Runs raynestd, which must end with `code` and, where it fails, one line."""
        done = subprocess.run([self.raynestd, *map(str, arguments)], stdin=subprocess.DEVNULL, text=True,
                              capture_output=True, timeout=PATIENCE, **options)
        self.assertEqual(done.returncode, code, done.stdout + done.stderr)
        self.assertIn(says, done.stdout + done.stderr)
        if code:
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        return done.stdout

    def token(self, code, says, *arguments, **options):
        return self.does(code, says, "token", *arguments, "--tokens", options.pop("file", self.tokens.file),
                         **options)

    def daemon(self, certificates, *arguments):
        daemon = SecureDaemon(self.raynestd, certificates, *arguments)
        self.addCleanup(daemon.stop)
        return daemon

    def asks(self, daemon, certificates, *arguments, token=None):
        """Runs a harmless command, and returns its exit code and its words."""
        done = SecureClient(self.raynest, daemon.tls, certificates.ca, token).run(*arguments, "scenes")
        return done.returncode, done.stdout + done.stderr

    @staticmethod
    def content(folder):
        return {file.name: file.read_bytes() for file in folder.iterdir()}

    # ---- token

    def test_a_command_without_its_second_word_names_them(self):
        for group, names in (("token", "add, list, revoke"), ("tls", "init, renew")):
            for words in ((), ("--tokens", "x")):
                self.does(2, f"{group} needs a command; use one of: {names}", group, *words)
            self.does(2, f"there is no command '{group} foo'; use one of: {names}", group, "foo")
            self.does(0, names.split(", ")[0], group, "--help")

    def test_no_command_makes_a_token_file_unusable(self):
        self.tokens.add("alice")
        before = self.tokens.file.read_bytes()
        for subject in ("", "robot", "CN=a\nb", "CN=a\n# b", "CN=a\x1b[2J", "CN = robot, O = Lab", "/CN=robot",
                        "CN=robot,", "CN=" + "a" * 200, " "):
            for act in ("add", "revoke"):
                with self.subTest(act, subject=subject):
                    self.token(2, "is not a certificate's subject", act, "--cert", subject)
        self.token(2, "'public' means everybody", "add", "public")
        self.token(2, "", "add", "")
        for period in ("90000d", "36501d", "3153600001s", "99999999999999999999d", "0d", "-1d"):
            self.token(2, "at most 36500d", "add", "late", "--expires", period)
        self.assertEqual(self.tokens.file.read_bytes(), before)
        self.token(0, "", "add", "late", "--expires", "36500d")
        self.assertRegex(self.token(0, "", "list"), r"late\tuser\t21\d\d-")

    def test_an_expired_name_is_given_a_new_token(self):
        for who in (("guest",), ("--cert", "CN=guest,O=Lab")):
            self.token(0, "may connect", "add", *who, "--expires", "1s")
            until(lambda: "(expired)" in self.token(0, "", "list"))
            self.token(0, "had expired, and may connect as viewer", "add", *who, "--role", "viewer")
            self.token(1, "exists", "add", *who)

    def test_what_has_no_row_is_not_said_to_be_revoked(self):
        self.tokens.add("alice")
        before = self.tokens.file.read_bytes()
        self.token(5, "no such token: 'bob'", "revoke", "bob")
        self.token(5, "no row of a certificate 'O=Lab,CN=robot'", "revoke", "--cert", "O=Lab,CN=robot")
        self.assertEqual(self.tokens.file.read_bytes(), before)
        self.token(0, "alice is revoked", "revoke", "alice")
        self.token(5, "no such token", "revoke", "alice")
        # A row that matches no certificate, as another program may have written it, can be taken away.
        self.tokens.file.write_text("cert user never - - CN = robot, O = Lab\n")
        self.token(0, "is revoked", "revoke", "--cert", "CN = robot, O = Lab")
        self.assertNotIn("robot", self.tokens.file.read_text())

    def test_a_certificate_without_a_row_can_be_shut_out(self):
        certificates = self.certificates()
        robot = certificates.sign("robot", "/O=Lab/CN=robot")
        self.tokens.add("alice")
        daemon = self.daemon(certificates, "--client-ca", certificates.ca, "--tokens", self.tokens.file)
        self.assertEqual(self.asks(daemon, certificates, *robot)[0], 0)
        self.token(0, "and no others", "revoke", "--cert", "CN=robot,O=Lab", "--unlisted")
        # A connection that is open at that moment is told in other words.
        code, _ = until(lambda: "CN=robot,O=Lab has expired or was revoked" in (
            said := self.asks(daemon, certificates, *robot))[1] and said)
        self.assertEqual(code, 4)
        self.token(0, "CN=robot,O=Lab is revoked", "revoke", "--cert", "CN=robot,O=Lab")

    def test_a_link_to_the_token_file_stays_a_link(self):
        """Whether the daemon or the administrator goes through the link, a revoked token is out."""
        certificates = self.certificates()
        link = self.out / "link"
        for name in ("alice", "bob"):
            secret = self.tokens.add(name)
            link.unlink(missing_ok=True)
            link.symlink_to(self.tokens.file.name)
            watched, edited = (link, self.tokens.file) if name == "alice" else (self.tokens.file, link)
            daemon = self.daemon(certificates, "--tokens", watched)
            self.assertEqual(self.asks(daemon, certificates, token=secret)[0], 0)
            self.token(0, "may connect", "add", f"{name}2", file=edited)
            self.token(0, "is revoked", "revoke", name, file=edited)
            until(lambda: self.asks(daemon, certificates, token=secret)[0] == 4)
            self.assertTrue(link.is_symlink())
            self.assertIn(f"{name}2", self.tokens.file.read_text())
        self.tokens.file.unlink()
        self.token(1, "leads to: No such file", "add", "eve", file=link)

    @unittest.skipIf(os.geteuid() != 0, "only root may give files away")
    def test_root_edits_the_files_of_the_daemons_user(self):
        """The procedure of OPERATING.md."""
        self.out.chmod(0o755)
        etc = self.out / "etc"
        etc.mkdir(0o755)
        tokens = etc / "tokens"
        certificates = Certificates(self.raynestd, etc / "tls")
        self.token(0, "", "add", "alice", file=tokens)
        ca_key = etc / "tls" / "ca-key.pem"
        given = {tokens, etc / "tls", *(etc / "tls").iterdir()} - {ca_key}
        for file in given:
            os.chown(file, OTHER, OTHER + 1)
        def owners():
            return {file: (file.stat().st_uid, file.stat().st_gid, stat.S_IMODE(file.stat().st_mode))
                    for file in given - {etc / "tls"}}
        before = owners()
        self.assertEqual(set(before.values()), {(OTHER, OTHER + 1, 0o600)})
        self.assertIn("alice", self.token(0, "", "list", file=tokens))
        self.token(0, "", "add", "bob", file=tokens)
        self.token(0, "", "revoke", "alice", file=tokens)
        self.does(0, "renewed for 397 days", "tls", "renew", certificates.folder)
        self.assertEqual(owners(), before)
        # The owner of the CA's key can sign, and so can those who may read it.
        os.chown(ca_key, OTHER, OTHER + 1)
        self.does(1, f"it belongs to the user {OTHER}, who can sign with it", "tls", "renew",
                  certificates.folder)
        os.chown(ca_key, 0, OTHER + 1)
        ca_key.chmod(0o640)
        self.does(1, "chmod 600", "tls", "renew", certificates.folder)
        as_other = {"user": OTHER, "group": OTHER + 1, "extra_groups": []}
        self.assertIn("bob", self.token(0, "", "list", file=tokens, **as_other))
        self.token(1, "Permission denied; run this command as root", "add", "eve", file=tokens, **as_other)
        # Files that its user cannot read: the line names the command that gives them.
        os.chown(tokens, 0, 0)
        self.token(1, "Permission denied; run this command as root", "list", file=tokens, **as_other)
        self.does(1, f"Permission denied; as root: chown {OTHER} {tokens}", "--listen", "tcp://127.0.0.1:0",
                  "--http", "off", "--cuda", "off", "--tokens", tokens, **as_other)
        # A link that its user made does not lead root elsewhere.
        secret = self.out / "secret"
        secret.write_bytes(b"")
        secret.chmod(0o600)
        link = etc / "tls" / "tokens"
        link.symlink_to(secret)
        os.chown(link, OTHER, OTHER, follow_symlinks=False)
        self.token(1, "belongs to another user than its target", "add", "eve", file=link)
        self.assertEqual(secret.read_bytes(), b"")

    @unittest.skipIf(os.geteuid() != 0, "only root may give files away")
    def test_a_group_of_the_daemon_reads_what_root_owns(self):
        """The procedure of OPERATING.md."""
        self.out.chmod(0o755)
        folder = self.certificates().folder
        self.tokens.add("alice")
        for file in (folder, folder / "ca.pem", folder / "cert.pem", folder / "key.pem", self.tokens.file):
            os.chown(file, 0, OTHER + 1)
            file.chmod(file.stat().st_mode | (0o050 if file.is_dir() else 0o040))
        check = ("--listen", "tls://127.0.0.1:0", "--http", "off", "--tls-cert", folder / "cert.pem",
                 "--tls-key", folder / "key.pem", "--tokens", self.tokens.file, "--check-config")
        self.does(0, "the configuration is valid", *check, user=OTHER, group=OTHER + 1, extra_groups=[])
        self.does(0, "the configuration is valid", *check, user=OTHER, group=OTHER, extra_groups=[OTHER + 1])
        self.does(0, "renewed for 397 days", "tls", "renew", folder)
        self.tokens.add("bob")
        said = self.does(0, "valid", *check, user=OTHER, group=OTHER + 1, extra_groups=[])
        self.assertNotIn("warning", said)
        os.chown(folder / "ca-key.pem", 0, OTHER + 1)
        (folder / "ca-key.pem").chmod(0o640)
        self.does(0, f"warning: this user can read {folder}/ca-key.pem", *check, user=OTHER,
                  group=OTHER + 1, extra_groups=[])
        (folder / "key.pem").chmod(0o660)
        self.does(1, "mode 640 and a group of the daemon", *check, user=OTHER, group=OTHER + 1, extra_groups=[])
        (folder / "key.pem").chmod(0o600)
        os.chown(folder / "key.pem", OTHER, OTHER)
        self.does(1, f"it belongs to the user {OTHER}; run the daemon as that user", *check)

    @unittest.skipIf(os.geteuid() != 0, "only root has other users' rights")
    def test_root_checks_the_package_s_configuration_as_the_daemon_s_user(self):
        etc = self.out / "etc"
        (etc / "raynest").mkdir(parents=True)
        (etc / "passwd").write_text(f"root:x:0:0::/:/bin/sh\nraynest:x:{OTHER}:{OTHER + 1}::/:/bin/false\n")
        (etc / "group").write_text(f"root:x:0:\nraynest:x:{OTHER + 1}:\n")
        tokens = etc / "raynest" / "tokens"
        self.token(0, "", "add", "alice", file=tokens)
        config = 'listen = "tcp://127.0.0.1:0"\nhttp = "off"\ntokens = "tokens"\n'
        (etc / "raynest" / "raynestd.toml").write_text(config)
        script = ('mount -t tmpfs none /etc && cp -a "$0"/. /etc/ && chown "$1" /etc/raynest/tokens && '
                  'shift && exec "$@"')

        def check(owner, code, says, expect):
            within = ("unshare", "--mount", "sh", "-c", script, etc, owner)
            if subprocess.run([*within, "true"], capture_output=True, check=False).returncode != 0:
                self.skipTest("skipped: needs mount namespaces")
            done = subprocess.run([*within, self.raynestd, "--config", "/etc/raynest/raynestd.toml",
                                   "--check-config"], capture_output=True, text=True, check=False,
                                  timeout=PATIENCE)
            self.assertEqual((done.returncode, says in expect(done)), (code, True), done)
        check(str(OTHER), 0, "the configuration is valid for the user raynest", lambda done: done.stdout)
        check("0", 1, "Permission denied; as root: chown raynest /etc/raynest/tokens", lambda done: done.stderr)
        check("0", 1, "(checked as the user raynest)", lambda done: done.stderr)

    # ---- tls

    def test_only_what_the_ca_has_signed_is_renewed(self):
        folder = self.certificates().folder
        before = self.content(folder)
        made = openssl("req", "-x509", "-new", "-key", folder / "key.pem", "-subj", "/CN=x", "-days", "3",
                       "-addext", "subjectAltName=DNS:payroll.example.org", "-out", folder / "cert.pem")
        self.assertEqual(made.returncode, 0, made.stdout)
        self.does(1, "cert.pem: this CA has not signed it", "tls", "renew", folder)
        for name in ("cert.pem", "key.pem"):
            shutil.copy(folder / f"client-{name}", folder / name)
        self.does(1, "cert.pem: it was signed for another use", "tls", "renew", folder)
        for name in ("cert.pem", "key.pem"):
            (folder / name).write_bytes(before[name])
        for name in ("cert.pem", "key.pem"):
            shutil.copy(folder / name, folder / f"client-{name}")
        self.does(1, "client-cert.pem: it was signed for another use", "tls", "renew", folder)
        self.assertEqual((folder / "cert.pem").read_bytes(), before["cert.pem"])

    def test_renewing_needs_the_keys_that_belong_to_the_certificates(self):
        folder, other = self.certificates().folder, self.certificates("other").folder
        before = self.content(folder)
        for key, certificate in (("ca-key.pem", "ca.pem"), ("client-key.pem", "client-cert.pem")):
            shutil.copy(other / key, folder / key)
            self.does(1, f"{key}: this key does not belong to {certificate}", "tls", "renew", folder)
            (folder / key).write_bytes(before[key])
        for name in before:
            (folder / name).unlink()
            self.does(1, f"{name}: it is missing", "tls", "renew", folder)
            (folder / name).write_bytes(before[name])
            (folder / name).chmod(0o600)
        self.does(1, "it is missing", "tls", "renew", self.out / "nowhere")
        self.assertEqual(self.content(folder), before)
        # Both certificates or none: a new file beside the second one would have too long a name.
        client = self.out / ("n" * 255)
        (folder / "client-cert.pem").rename(client)
        (folder / "client-cert.pem").symlink_to(client)
        self.does(1, "name too long", "tls", "renew", folder)
        self.assertEqual(self.content(folder), before)

    @staticmethod
    def small_disk(folder, name):
        """Options of a process that may write files much smaller than this one."""
        limit = (folder / name).stat().st_size - 50
        return {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
                "restore_signals": False}

    def with_ca_of(self, folder, days):
        """Signs the CA anew, which then ends in so many days."""
        made = openssl("x509", "-in", folder / "ca.pem", "-signkey", folder / "ca-key.pem", "-days", days,
                       "-out", self.out / "new-ca.pem")
        self.assertEqual(made.returncode, 0, made.stdout)
        shutil.copyfile(self.out / "new-ca.pem", folder / "ca.pem")

    def test_renewed_certificates_end_with_their_ca(self):
        folder = self.certificates().folder
        self.with_ca_of(folder, 5)
        said = self.does(0, "when their CA ends", "tls", "renew", folder)
        self.assertRegex(said, "renewed for [45] days")
        for name in ("cert.pem", "client-cert.pem"):
            self.assertEqual(openssl("x509", "-in", folder / name, "-checkend", 4 * DAY).returncode, 0)
            self.assertEqual(openssl("x509", "-in", folder / name, "-checkend", 6 * DAY).returncode, 1)
        self.with_ca_of(folder, -1)
        before = self.content(folder)
        self.does(1, "this CA has expired", "tls", "renew", folder)
        self.assertEqual(self.content(folder), before)

    def test_a_full_disk_leaves_no_half_of_a_ca(self):
        whole = self.certificates().folder
        folder = self.out / "half"
        # The CA and the keys fit, the server's certificate does not.
        limit = self.small_disk(whole, "cert.pem")
        self.assertGreater((whole / "cert.pem").stat().st_size, (whole / "ca.pem").stat().st_size + 60)
        self.does(1, "File too large", "tls", "init", folder, **limit)
        self.assertFalse(folder.exists())
        folder.mkdir()
        self.does(1, "File too large", "tls", "init", folder, **limit)
        self.assertEqual(self.content(folder), {})
        self.does(0, "certificate of", "tls", "init", folder)
        self.does(0, "renewed for 397 days", "tls", "renew", folder)

    # ---- files that cannot be used

    def unusable(self, certificates):
        """(option, what is put in the file's place, what is said) of all files that TLS reads."""
        def pipe(file):
            os.mkfifo(file)

        def large(file):
            with open(file, "wb") as opened:
                opened.truncate(1 << 32)
            file.chmod(0o600)

        def device(file):
            file.symlink_to("/dev/zero")

        def secret(file):
            made = openssl("ec", "-in", certificates.folder / "key.pem", "-aes256", "-passout", "pass:secret",
                           "-out", file)
            self.assertEqual(made.returncode, 0, made.stdout)
            file.chmod(0o600)
        for option in ("cert.pem", "key.pem", "ca.pem"):
            yield option, pipe, "is not a regular file"
            yield option, device, "is not a regular file"
            yield option, pathlib.Path.mkdir, "it is a folder"
            yield option, large, "it is over 1048576 bytes"
        yield "key.pem", secret, "the key has a password"

    def test_a_client_with_a_long_chain_is_refused_before_it_is_read(self):
        """All certificates of a chain are taken apart before one is verified."""
        certificates = self.certificates()
        daemon = self.daemon(certificates, "--client-ca", certificates.ca)
        _, own, *key = certificates.sign("robot", "/CN=robot")
        for others, served in ((1, True), (30, False)):
            chain = self.out / "chain.pem"
            chain.write_text(own.read_text() + others * certificates.ca.read_text())
            self.assertEqual(self.asks(daemon, certificates, "--cert", chain, *key)[0] == 0, served, others)

    def test_files_that_cannot_be_read_end_the_start_and_change_nothing_later(self):
        certificates = self.certificates()
        options = (*certificates.server, "--client-ca", certificates.ca)
        daemon = self.daemon(certificates, "--client-ca", certificates.ca)
        good = self.content(certificates.folder)
        shutil.copy(certificates.ca, self.out / "known.pem")
        certificates.ca = self.out / "known.pem"
        client = certificates.sign("robot", "/CN=robot")
        for name, put, says in self.unusable(certificates):
            with self.subTest(name, says=says, put=put.__name__):
                file = certificates.folder / name
                aside = file.rename(self.out / "aside")
                if put.__name__ == "secret":
                    shutil.copy(aside, file)
                    file, place = self.out / "locked", file
                    put(file)
                    file = file.rename(place)
                else:
                    put(file)
                self.does(1, says, "--listen", "tls://127.0.0.1:0", *options, "--http", "off", "--cuda", "off")
                lines = daemon.log().count("certificate_unusable")
                daemon.process.send_signal(signal.SIGHUP)
                until(lambda: daemon.log().count("certificate_unusable") > lines)
                self.assertIn(says, daemon.log().splitlines()[-2] + daemon.log().splitlines()[-1])
                self.assertEqual(self.asks(daemon, certificates, *client)[0], 0)
                shutil.rmtree(file) if file.is_dir() else file.unlink()
                aside.rename(file)
        self.assertEqual(self.content(certificates.folder), good)
        self.assertNotIn("Enter PEM", daemon.log())

    def test_a_weak_key_is_told_in_words(self):
        certificates = self.certificates()
        folder = self.out / "weak"
        folder.mkdir()
        made = openssl("req", "-x509", "-newkey", "rsa:1024", "-nodes", "-keyout", folder / "key.pem",
                       "-subj", "/CN=weak", "-out", folder / "cert.pem")
        self.assertEqual(made.returncode, 0, made.stdout)
        (folder / "key.pem").chmod(0o600)
        self.does(1, "its key is too short to be safe", "--listen", "tls://127.0.0.1:0", "--tls-cert",
                  folder / "cert.pem", "--tls-key", folder / "key.pem", "--http", "off", "--cuda", "off")
        daemon = self.daemon(certificates)
        code, words = self.asks(daemon, certificates, "--cert", folder / "cert.pem", "--key", folder / "key.pem")
        self.assertEqual(code, 2)
        self.assertIn("its key is too short to be safe", words)

    def test_a_missing_file_of_a_client_is_named(self):
        certificates = self.certificates()
        daemon = self.daemon(certificates)
        _, cert, _, key = certificates.client
        for arguments in (("--cert", self.out / "none", "--key", key), ("--cert", cert, "--key", self.out / "none")):
            code, words = self.asks(daemon, certificates, *arguments)
            self.assertEqual(code, 2)
            self.assertIn("none: No such file", words)

    # ---- subjects

    def test_a_subject_that_names_nobody_is_told_to_both_ends(self):
        certificates = self.certificates()
        daemon = self.daemon(certificates, "--client-ca", certificates.ca, "--tokens", self.tokens.file) \
            if self.tokens.add("alice") else None
        long = "".join(f"/OU={letter * 60}" for letter in "abcd")
        for name, subject, says in (("empty", "/", "is empty"), ("long", long, "is over 200 bytes")):
            code, words = self.asks(daemon, certificates, *certificates.sign(name, subject))
            self.assertEqual(code, 4)
            self.assertIn(f"the subject of this client's certificate {says}", words)
            self.assertIn(f"the subject of this client's certificate {says}", daemon.log())
        self.assertNotIn("no token", daemon.log())

    def test_a_scene_is_shared_with_the_subject_that_was_named(self):
        certificates = self.certificates()
        robots = {name: certificates.sign(name, subject) for name, subject in (
            ("whole", "/O=Lab/CN=robot"), ("part", "/CN=robot"), ("comma", "/CN=Smith, John"))}
        daemon = self.daemon(certificates, "--client-ca", certificates.ca, "--tokens", self.tokens.file) \
            if (token := self.tokens.add("alice")) else None
        alice = SecureClient(self.raynest, daemon.tls, certificates.ca, token)

        def load(*shares):
            words = [word for share in shares for word in ("--share", share)]
            return alice.run("load", "builtin:terrain?size=8", "--name", "hills", *words)

        def seen():
            return {name for name, robot in robots.items()
                    if "alice/hills" in self.asks(daemon, certificates, *robot)[1]}
        for unclear in ("CN=robot,O=Lab", "bob,CN=robot,O=Lab", "CN = robot", "CN=Smith\\, John", "bob,,eve", ""):
            done = load(unclear)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (2, 1), (unclear, done.stderr))
        self.assertEqual(seen(), set())
        for shares, sees in ((("CN=robot\\,O=Lab",), {"whole"}), (("bob,CN=robot",), {"part"}),
                             (("CN=robot\\,O=Lab", "CN=Smith\\\\\\, John"), {"whole", "comma"})):
            done = load(*shares)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(seen(), sees)
        shown, = alice.json("scenes")["scenes"]
        self.assertEqual(shown["share"], "CN=Smith\\\\\\, John,CN=robot\\,O=Lab")
        self.assertIn("\\,", alice.run("load", "--help").stdout)


if __name__ == "__main__":
    main()
