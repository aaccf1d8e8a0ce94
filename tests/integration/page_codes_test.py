#!/usr/bin/env python3
"""Tests the codes of `raynest open`: whom they log in, once, in time, and not before the user has agreed.

  page_codes_test.py RAYNESTD RAYNEST
"""
import os
import sys
import time

from daemon import main, until
from secure_daemon import SecureClient
from websocket import greeted, post
from with_page import WithPage


class PageCodes(WithPage):
    def test_a_code_logs_in_once_as_its_caller(self):
        local = SecureClient(self.raynest, f"unix:{self.out}/code")
        daemon = self.own_daemon("--http", "127.0.0.1:0", "--listen", local.uri)
        uid = f"uid:{os.getuid()}"
        for client, principal, role in ((local, uid, "admin"),
                                        (self.client("viewer", daemon), "test-viewer", "viewer")):
            code = self.code(client)
            cookie = self.log_in(daemon.http, code=code)
            self.assertEqual(self.who(daemon.http, cookie),
                             {"principal": principal, "role": role, "login": True})
            with greeted(daemon.http, headers=cookie) as stream:
                client.json("scenes")
                stream.say("Page", 1)
                self.assertEqual(stream.hear()[2]["http"], daemon.http)
            # A replay, a code that never was, and half a code.
            for wrong in (code, "0" * 64, self.code(client)[:32]):
                status, headers, body = post(daemon.http, "/v1/login", "code=" + wrong)
                self.assertEqual(status, 401)
                self.assertIn(b"was used or has expired", body)
                self.assertNotIn("set-cookie", headers)
        # Without a code the page is whoever comes from loopback.
        self.assertEqual(self.who(daemon.http), {"principal": "127.0.0.1", "role": "user", "login": False})
        self.assertNotIn(code, daemon.log())

    def test_a_code_expires(self):
        daemon = self.own_daemon("--http", "https://127.0.0.1:0", "--page-code-ms-max", "50")
        code = self.code(self.client("user", daemon))
        time.sleep(0.1)
        self.assertEqual(post(daemon.http, "/v1/login", "code=" + code)[0], 401)

    def test_a_code_ends_with_the_token_of_its_caller(self):
        secret = self.tokens.add("leaver")
        until(lambda: self.client(secret).run("scenes").returncode == 0)
        code = self.code(self.client(secret))
        self.tokens.revoke("leaver")
        until(lambda: self.client(secret).run("scenes").returncode == 4)
        self.assertEqual(post(self.http, "/v1/login", "code=" + code)[0], 401)

    def page_code(self, http, cookie):
        """A code that the page of this login asks for."""
        with greeted(http, headers=cookie) as stream:
            return stream.ask("Page", 1)[-1][2]["code"]

    def test_a_login_that_a_login_has_made_ends_with_it_and_when_it_does(self):
        daemon = self.own_daemon("--http", "https://127.0.0.1:0", "--page-login-ms-max", "4000")
        begun = time.monotonic()
        first = self.log_in(daemon.http, token=self.secrets["user"])
        second = self.log_in(daemon.http, code=self.page_code(daemon.http, first))
        time.sleep(max(0, begun + 2 - time.monotonic()))
        last = self.log_in(daemon.http, code=self.page_code(daemon.http, second))
        # The middle one takes its own along, and leaves its parent.
        self.assertEqual(post(daemon.http, "/v1/logout", headers=second)[0], 200)
        self.assertEqual([self.who(daemon.http, each) == 401 for each in (first, second, last)], [False, True, True])
        last = self.log_in(daemon.http, code=self.page_code(daemon.http, first))
        with greeted(daemon.http, headers=last) as stream:
            self.assertTrue(self.hears_of_the_end(stream))
        # 6 s would be a time of its own; a slow machine may be late, too.
        print(f"the login of a login ended after {time.monotonic() - begun:.1f} s of 4", file=sys.stderr)
        self.assertEqual(self.who(daemon.http, first), 401)
        self.assertEqual(self.who(daemon.http, last), 401)

    def test_a_code_asks_before_it_logs_in_another_where_nobody_is(self):
        local = SecureClient(self.raynest, f"unix:{self.out}/question")
        daemon = self.own_daemon("--http", "127.0.0.1:0", "--listen", local.uri)
        # A page that needs no login, and one that does.
        for http in (daemon.http, self.http):
            code = self.code(self.client("user", daemon if http == daemon.http else None))
            status, headers, body = post(http, "/v1/login", "code=" + code)
            self.assertEqual(status, 409, body)
            self.assertIn(b"is not logged in, and the address logs it in as test-user", body)
            self.assertNotIn("set-cookie", headers)
            self.assertEqual(post(http, "/v1/login", f"code={code}&agreed=no")[0], 409)
            self.assertEqual(post(http, "/v1/login", f"code={code}&agreed=yes")[0], 200)
        # Nobody else has a code of the daemon's own user.
        self.assertEqual(post(daemon.http, "/v1/login", "code=" + self.code(local))[0], 200)

    def test_a_code_asks_before_it_replaces_the_login_of_another(self):
        mine = self.log_in(self.http, token=self.secrets["user"])
        code = self.code(self.client("viewer"))
        status, headers, body = post(self.http, "/v1/login", "code=" + code, headers=mine)
        self.assertEqual(status, 409, body)
        self.assertIn(b"is logged in as test-user, and the address logs it in as test-viewer", body)
        self.assertNotIn("set-cookie", headers)
        self.assertEqual(self.who(self.http, mine)["principal"], "test-user")
        with greeted(self.http, headers=mine) as stream:
            status, headers, _ = post(self.http, "/v1/login", f"code={code}&agreed=yes", headers=mine)
            self.assertEqual(status, 200)
            self.assertTrue(self.hears_of_the_end(stream))
        self.assertEqual(self.who(self.http, mine), 401)
        now = ["Cookie: " + headers["set-cookie"].split(";")[0]]
        self.assertEqual(self.who(self.http, now)["principal"], "test-viewer")
        # One's own code, a used code and a token ask nothing.
        self.assertEqual(post(self.http, "/v1/login", "code=" + self.code(self.client("viewer")), headers=now)[0], 200)
        self.assertEqual(post(self.http, "/v1/login", "code=" + code, headers=now)[0], 401)
        self.assertEqual(post(self.http, "/v1/login", "token=" + self.secrets["user"], headers=now)[0], 200)

    def test_codes_and_logins_of_one_principal_void_no_others(self):
        admins = self.code(self.client("admin"))
        cookie = self.log_in(self.http, token=self.secrets["admin"])
        bearer = ["Authorization: Bearer " + self.secrets["viewer"]]
        with greeted(self.http, headers=bearer) as stream:
            for number in range(1, 301):
                self.assertEqual(stream.ask("Page", number)[-1][0], "PageAddress")
        for _ in range(70):
            self.log_in(self.http, token=self.secrets["viewer"])
        self.assertEqual(self.who(self.http, cookie)["principal"], "test-admin")
        self.log_in(self.http, code=admins)


if __name__ == "__main__":
    main()
