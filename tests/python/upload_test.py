#!/usr/bin/env python3
"""Scene files by way of the Python client become what the command line makes of them. Exit code 77
(skipped) where the shared scenes are not there.

  upload_test.py RAYNESTD RAYNEST FLATC
"""
import json

from daemon import SHARED_SCENES
from with_daemon import WithDaemon, main


class Upload(WithDaemon):
    def test_files_come_with_what_they_name(self):
        if not SHARED_SCENES.is_dir():
            self.skipTest(f"skipped: {SHARED_SCENES} is not there")
        loaded = 0
        for path in sorted(SHARED_SCENES.rglob("small/**/*.gl*")):
            with self.subTest(path=str(path)):
                expected = self.cli.run("--json", "load", path, "--name", "by-cli", "--replace")
                news = []
                scene = self.client.load(path, "by-python", replace=True,
                                         progress=lambda *item: news.append(item))
                self.assertEqual(scene.info["hash"], json.loads(expected.stdout)["hash"])
                self.assertTrue(news)
                loaded += 1
        self.assertGreater(loaded, 2)


if __name__ == "__main__":
    main()
