#!/usr/bin/env python3
"""The checks can fail: each planted violation is found, and a clean tree passes."""
import importlib.util
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

HERE = pathlib.Path(__file__).parent


class Planted(unittest.TestCase):
    def setUp(self):
        self.root = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def plant(self, files):
        for name, text in files.items():
            path = self.root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    def check(self, script):
        run = subprocess.run([sys.executable, HERE / script, self.root],
                             capture_output=True, text=True, check=False)
        return run.returncode, run.stdout


class Includes(Planted):
    def assert_refused(self, file, include, reason):
        self.plant({file: f"#include {include}\n"})
        code, text = self.check("check_includes.py")
        self.assertEqual(code, 1, text)
        self.assertIn(reason, text)

    def test_downward_includes_pass(self):
        self.plant({"engine/bvh/a.h": '#include "engine/math/vec.h"\n#include <vector>\n',
                    "engine/assets/a.cpp": '#include "engine/packs/registry.h"\n',
                    "server/jobs/a.cpp": '#include "engine/scene/x.h"\n#include "protocol/frame.h"\n'})
        self.assertEqual(self.check("check_includes.py")[0], 0)

    def test_lists_are_open_to_those_that_name_them(self):
        self.plant({"client/ground/a.cpp": '#include "engine/queries/fields.def"\n'})
        self.assertEqual(self.check("check_includes.py")[0], 0)
        self.assert_refused("client/net/a.cpp", '"engine/queries/fields.def"', "client/net may not include")

    def test_folders_of_one_row_form_no_circle(self):
        self.plant({"engine/packs/a.h": "", "engine/packs/new/b.h": '#include "engine/packs/a.h"\n'})
        self.assertEqual(self.check("check_includes.py")[0], 0)
        self.assert_refused("engine/packs/a.h", '"engine/packs/new/b.h"',
                            "a circle of folders: engine/packs -> engine/packs/new -> engine/packs")

    def test_an_empty_tree_is_not_a_pass(self):
        self.assertEqual(self.check("check_includes.py")[0], 1)

    def test_engine_does_not_know_protocol(self):
        self.assert_refused("engine/bvh/a.h", '"protocol/frame.h"', "engine/bvh may not include")

    def test_protocol_does_not_know_engine(self):
        self.assert_refused("protocol/a.h", '"engine/result.h"', "protocol may not include")

    def test_client_does_not_know_the_engine(self):
        self.assert_refused("client/a.cpp", '"engine/result.h"', "client may not include")

    def test_the_rooms_of_the_client_look_down_only(self):
        self.assert_refused("client/ground/a.cpp", '"client/net/b.h"', "client/ground may not include")
        self.assert_refused("client/requests/a.cpp", '"client/output/b.h"', "client/requests may not")

    def test_kernels_do_not_know_the_scene(self):
        self.assert_refused("engine/packs/a.h", '"engine/scene/x.h"', "engine/packs may not")

    def test_assets_see_only_the_registry_of_packs(self):
        self.assert_refused("engine/assets/a.h", '"engine/packs/abi.h"', "engine/assets may not")

    def test_a_row_does_not_stand_for_the_rows_within(self):
        self.assert_refused("engine/assets/a.cpp", '"engine/assets/sandbox/a.h"', "engine/assets may not")

    def test_a_heavy_header_has_one_home(self):
        self.assert_refused("engine/scene/a.cpp", "<OpenImageIO/imageio.h>", "may not be included")

    def test_a_heavy_header_has_one_file(self):
        self.plant({"engine/assets/gltf/file/a.cpp": "#include <tiny_gltf.h>\n"})
        self.assert_refused("engine/assets/gltf/file/b.cpp", "<tiny_gltf.h>", "included by 2 files")

    def test_rooms_of_the_server_do_not_look_up(self):
        self.assert_refused("server/net/a.h", '"server/sessions/session.h"', "server/net may not")
        self.assert_refused("server/jobs/a.h", '"server/requests/request.h"', "server/jobs may not")
        self.assert_refused("server/a.h", '"server/ground/log.h"', "no known layer")

    def test_a_row_names_only_rows_above_it(self):
        spec = importlib.util.spec_from_file_location("check_includes", HERE / "check_includes.py")
        checks = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(checks)
        self.assertEqual(list(checks.upward_rows(checks.ALLOWED)), [])
        circle = {"a": ["b"], "b": ["a"]}
        self.assertEqual(len(list(checks.upward_rows(circle))), 1)

    def test_a_new_folder_must_be_named(self):
        self.assert_refused("engine/novel/a.h", '"engine/result.h"', "no known layer")


class Imports(Planted):
    """check_includes.py reads the imports of the Python package."""

    def module_of(self, name, text):
        self.plant({"engine/bvh/a.h": '#include "engine/math/vec.h"\n', f"client/python/raynest/{name}.py": text})

    def assert_refused(self, reason):
        code, output = self.check("check_includes.py")
        self.assertEqual(code, 1, output)
        self.assertIn(reason, output)

    def test_downward_imports_pass(self):
        self.module_of("_net/frame", "from .. import errors, _limits\nfrom .control import decode\nimport os\n")
        self.module_of("_net/control", "from ..errors import Error\nfrom . import schema\n")
        self.module_of("_net/schema", "import struct\n")
        self.module_of("errors", "from ._limits import x\n")
        self.module_of("_limits", "")
        self.module_of("scene", "from ._net import frame\nfrom .errors import Error\n")
        self.module_of("__init__", "from . import compat\nfrom .scene import Scene\n")
        self.module_of("compat/__init__", "from . import trimesh as trimesh\n")
        self.module_of("compat/trimesh", "from ..scene import Scene\n")
        code, output = self.check("check_includes.py")
        self.assertEqual(code, 0, output)

    def test_rooms_do_not_look_up(self):
        self.module_of("client", "")
        self.module_of("_requests/rays", "")
        for name, text, reason in (
                ("scene", "from . import client as clients\n", "scene may not import client"),
                ("job", "if TYPE_CHECKING:\n    from .client import Client\n", "job may not import client"),
                ("_net/frame", "from .._requests.rays import Rays\n", "_net may not import _requests.rays"),
                ("_net/tls", "from .._requests import rays\n", "_net may not import _requests.rays"),
                ("images", "def f():\n    import raynest.client\n", "images may not import client"),
                ("errors", "from raynest.client import Client\n", "errors may not import client"),
                ("_session", "from . import Client\n", "_session may not import __init__")):
            with self.subTest(name=name):
                self.module_of(name, text)
                self.assert_refused(f"client/python/raynest/{name}.py: {reason}")

    def test_a_room_has_no_circle(self):
        self.module_of("_net/frame", "from .tls import a\n")
        self.module_of("_net/tls", "from . import uri\n")
        self.assertEqual(self.check("check_includes.py")[0], 0)
        self.module_of("_net/uri", "from .frame import b\n")
        self.assert_refused("a circle of imports: _net.")

    def test_a_new_module_must_be_named(self):
        self.module_of("novel", "")
        self.assert_refused("no known room")


class Page(Planted):
    """check_includes.py reads the imports of the page's modules."""

    MODULES = {"engine/bvh/a.h": '#include "engine/math/vec.h"\n', "server/web/lists.js": "export const A = 1;\n",
               "server/web/raynest.js": 'import { A } from "./lists.js";\n',
               "server/web/dom.js": 'import {\n  A,\n  B,\n} from "./lists.js";\n',
               "server/web/panels/ray.js": 'import { element } from "../dom.js";\nexport * from "./area.js";\n',
               "server/web/panels/area.js": "", "server/web/main.js": 'import "./panels/ray.js";\n'}

    def test_downward_imports_pass(self):
        self.plant(self.MODULES)
        code, output = self.check("check_includes.py")
        self.assertEqual(code, 0, output)

    def test_others_are_refused(self):
        for name, text, reason in (
                ("raynest.js", 'import {\n  element,\n} from "./dom.js";\n', "raynest.js: may not import dom.js"),
                ("dom.js", 'export { ray } from "./panels/ray.js";\n', "dom.js: may not import panels/ray.js"),
                ("dom.js", 'const ray = await import("./panels/ray.js");\n', "dom.js: may not import panels/ray.js"),
                ("panels/area.js", 'import "../main.js";\n', "area.js: may not import main.js"),
                ("panels/area.js", 'import { x } from "./ray.js";\n', "a circle of imports: "),
                ("dom.js", 'import { x } from "./gone.js";\n', "dom.js: ./gone.js is no module"),
                ("dom.js", 'import x from "https://example.org/x.js";\n', "is no module of the page")):
            with self.subTest(reason=reason):
                self.plant({**self.MODULES, f"server/web/{name}": text})
                code, output = self.check("check_includes.py")
                self.assertEqual(code, 1, output)
                self.assertIn(reason, output)


class House(Planted):
    def setUp(self):
        super().setUp()
        subprocess.run(["git", "init", "-q", self.root], check=True)

    def assert_refused(self, file, text, reason):
        self.plant({file: text})
        subprocess.run(["git", "-C", self.root, "add", "-A"], check=True)
        code, output = self.check("check_house.py")
        self.assertEqual(code, 1, output)
        self.assertIn(reason, output)

    def test_a_clean_tree_passes(self):
        self.plant({"README.md": "fine\n", ".ci/run": "#!/bin/bash\necho\n"})
        subprocess.run(["git", "-C", self.root, "add", "-A"], check=True)
        self.assertEqual(self.check("check_house.py")[0], 0)

    def test_top_level_entries_are_few(self):
        self.assert_refused("cmake/a.cmake", "\n", "not one of the top-level entries")

    def test_big_files_are_refused(self):
        self.assert_refused("tests/big.bin", "x" * ((1 << 20) + 1), "at most 1048576")

    def test_crowded_folders_are_refused(self):
        self.plant({f"engine/{i}.h": "" for i in range(40)})
        self.assert_refused("engine/a.h", "", "engine: 41 files, at most 40")

    def test_long_files_are_refused(self):
        for name in ("engine/a.h", "server/web/a.js", "engine/a.cmake", "engine/a.inc"):
            self.assert_refused(name, "\n" * 1000, f"{name}: 1000 lines")

    def test_folders_without_a_line_in_a_readme_are_refused(self):
        self.plant({"engine/README.md": "| `bvh/` | trees |\n| `assets/formats/` | files |\n"})
        for name in ("engine/bvh/a.h", "engine/assets/formats/a.h"):
            self.plant({name: ""})
            subprocess.run(["git", "-C", self.root, "add", "-A"], check=True)
            self.assertEqual(self.check("check_house.py"), (0, self.check("check_house.py")[1]))
        self.assert_refused("engine/novel/a.h", "", "engine/novel: no README above it")

    def test_unfinished_marks_are_refused(self):
        self.assert_refused("engine/a.h", "// TO" + "DO later\n", "an unfinished mark")

    def test_marks_of_merges_are_refused(self):
        for mark in ("<" * 7 + " ours", ">" * 7, "|" * 7 + " base"):
            self.assert_refused("engine/a.md", f"fine\n{mark}\nfine\n", "the mark of a merge")

    def test_messages_are_read_once(self):
        for name, text in (("server/requests/a.cpp", "int f(const wire::Job& job);\n"),
                           ("server/documents/a.h", "int f(const wire::Camera& camera);\n"),
                           ("server/jobs/a.cpp", "int f(const wire::Render& message);\n")):
            self.assert_refused(name, text, f"{name}: wire::")

    def test_machine_paths_are_refused(self):
        self.assert_refused("server/a.md", "see /home/" + "somebody/x\n", "somebody's machine")

    def test_broken_shell_is_refused(self):
        self.assert_refused("client/a.sh", "if true; then\n", "does not parse")


class Words(Planted):
    """check_words.py finds comments that begin badly, and names of dropped words."""

    def setUp(self):
        super().setUp()
        subprocess.run(["git", "init", "-q", self.root], check=True)

    def plant_and_check(self, files):
        self.plant(files)
        subprocess.run(["git", "-C", self.root, "add", "-A"], check=True)
        return self.check("check_words.py")

    def assert_refused(self, name, text, *reasons):
        code, output = self.plant_and_check({name: text})
        self.assertEqual(code, 1, output)
        for reason in reasons:
            self.assertIn(reason, output)

    def test_plain_words_pass(self):
        self.assertEqual(self.plant_and_check({
            "client/a.h": "/// The time of one request, which is what users wait for.\nclass LatencyCounts;\n"
                          'app.add_option("--rays", rays, "FILE");\nconst char* url = "http://What/";\n',
            "tests/a.py": '"""The p99 latency of a batch of requests."""\nclass Requests:\n    pass\n',
            "engine/words.def": 'RAYNEST_TRAVERSAL(stream, "stream", "for incoherent rays")\n',
            "README.md": "# What it is\n"})[0], 0)

    def test_an_empty_tree_is_not_a_pass(self):
        self.assertEqual(self.plant_and_check({})[0], 1)

    def test_comments_begin_with_their_subject(self):
        # Strings are written in parts, so that check_words.py does not find them here.
        for file, comment in (("a.h", "//" "/ Of one ray."), ("b.cpp", "int x;  //" "/< Who asks."),
                              ("c.py", 'def f():\n    ""' '"What it gives."""'), ("d.sh", "#" " Whatever ends this"),
                              ("e.cmake", "#" " Whoever builds"), ("f.cpp", "/" "* What it is */")):
            with self.subTest(file=file):
                self.assertEqual(self.plant_and_check({f"engine/{file}": 25 * f"{comment}\n"})[0], 0)
                self.assert_refused(f"engine/{file}", 26 * f"{comment}\n", f"engine/{file}:26", "a comment begins with '")
                (self.root / "engine" / file).unlink()

    def test_dropped_words_name_nothing(self):
        for file, text, reason in (
                ("engine/a.h", "struct RayTally {};\n", "a type is named RayTally: 'tally' is called statistics"),
                ("engine/b.h", "enum class Door { open };\n", "a type is named Door"),
                ("engine/c.h", "using Doors = int;\n", "'doors' is called entry point"),
                ("tests/d.py", "class BakedScene:\n    pass\n", "'baked' is called built"),
                ("client/e.cpp", 'app.add_flag(\n    "--bake", bake);\n', "an option is named --bake"),
                ("tests/f.py", 'parser.add_argument("--pie' 'ces")\n', "an option is named --pieces"),
                ("engine/door_test.cpp", "", "a file or folder is named door_test.cpp"),
                ("engine/errands/g.h", "", "a file or folder is named errands"),
                ("engine/words.def", 'RAYNEST_TRAVERSAL(batch, "coherent", "")\n', "a traversal is named batch"),
                ("engine/h.h", "class LatencyTraversal {};\n", "'latency' is called single")):
            with self.subTest(file=file):
                self.assert_refused(file, text, reason)


@unittest.skipUnless(shutil.which("clang-format-14"), "no clang-format-14 here")
class Format(Planted):
    """check_format.py finds a source that clang-format would change."""

    def check_source(self, text):
        subprocess.run(["git", "init", "-q", self.root], check=True)
        self.plant({"engine/a.h": text, ".clang-format": (HERE.parent / ".clang-format").read_text()})
        subprocess.run(["git", "-C", self.root, "add", "-A"], check=True)
        return self.check("check_format.py")

    def test_formatted_sources_pass(self):
        self.assertEqual(self.check_source("struct A {\n    int b = 0;\n};\n")[0], 0)

    def test_others_are_named(self):
        code, text = self.check_source("struct A {\n  int b=0;\n};\n")
        self.assertEqual(code, 1, text)
        self.assertIn("engine/a.h: clang-format-14 -i engine/a.h", text)


class Lists(Planted):
    """lists.py finds stale files; tested in a copy of the files that it reads and writes."""

    FILES = ("protocol/lists/errors.def", "protocol/lists/limits.def", "protocol/lists/requests.def",
             "protocol/lists/generators.def", "protocol/lists/reducers.def", "protocol/lists/roles.def", "protocol/lists/workers.def", "engine/queries/fields.def",
             "engine/geometry/counters.def", "engine/integrators/measures.def", "engine/packs/words.def",
             "engine/integrators/palettes.def", "engine/integrators/layers.def",
             "engine/integrators/tonemaps.def", "engine/integrators/integrators.def",
             "engine/integrators/integrator_settings.def", "server/ground/metrics.def",
             "client/ground/wording.def", "client/requests/other_files.def", "engine/packs/targets.def", "engine/intersectors/intersectors.def",
             "engine/packs/TARGETS.md",
             "protocol/PROTOCOL.md",
             "protocol/messages.fbs", "client/python/README.md",
             "client/python/raynest/_lists.py", "client/python/raynest/_limits.py",
             "server/web/lists.js",
             # The files where rows need more than themselves.
             "engine/intersectors/counts.h", "server/jobs/reduce_job.cpp", "server/web/tonemap.js",
             "client/python/raynest/_render.py", "client/python/raynest/generators.py")

    def setUp(self):
        super().setUp()
        self.plant({name: (HERE.parent / name).read_text(encoding="utf-8") for name in self.FILES})

    def lists(self, *options):
        run = subprocess.run([sys.executable, HERE.parent / ".ci/lists.py", *options, self.root],
                             capture_output=True, text=True, check=False)
        return run.returncode, run.stdout + run.stderr

    def test_a_new_row_makes_its_files_stale_until_they_are_written(self):
        for name, row, stale in (
                ("protocol/lists/errors.def", 'RAYNEST_ERROR(99, NEW, fresh, busy, "wait")',
                 ("protocol/PROTOCOL.md", "raynest/_lists.py")),
                ("protocol/lists/limits.def", 'RAYNEST_LIMIT(new_max, 2ULL << 20, fixed, "new, things")',
                 ("protocol/PROTOCOL.md", "raynest/_limits.py")),
                ("protocol/lists/requests.def", 'RAYNEST_REQUEST(99, New, fresh, nothing, user, once, plain, "Pong")',
                 ("protocol/PROTOCOL.md", "protocol/messages.fbs", "raynest/_lists.py", "server/web/lists.js")),
                ("engine/geometry/counters.def", 'RAYNEST_SUM(news, c.nodes, "news per ray")',
                 ("protocol/PROTOCOL.md", "python/README.md", "raynest/_lists.py",
                  "server/web/lists.js"))):
            path = self.root / name
            path.write_text(path.read_text(encoding="utf-8").replace("\n#undef", f"\n{row}\n#undef", 1))
            code, text = self.lists("--check")
            self.assertEqual(code, 1, name)
            self.assertEqual(text.count("is stale"), len(stale), text)
            for file in stale:
                self.assertIn(f"{file} is stale", text)
            self.assertEqual(self.lists(), (0, ""))
            self.assertEqual(self.lists("--check"), (0, ""))
        self.assertIn("| `new_max` | 2097152 | new, things |",
                      (self.root / "protocol/PROTOCOL.md").read_text(encoding="utf-8"))

    def test_a_row_without_its_function_is_named(self):
        for name, row, file, said in (
                ("engine/integrators/tonemaps.def", 'RAYNEST_TONEMAP(hable, "as film, with a shoulder")',
                 "server/web/tonemap.js", "vec3 hable"),
                ("engine/integrators/tonemaps.def", 'RAYNEST_TONEMAP(filmic, "as film")',
                 "client/python/raynest/_render.py", "filmic"),
                ("engine/geometry/counters.def", 'RAYNEST_COUNTER(pairs, "pairs per ray")',
                 "engine/intersectors/counts.h", "pairs"),
                ("protocol/lists/reducers.def", 'RAYNEST_REDUCER(farthest, closest, found, "t f32", "the farthest hit")',
                 "server/jobs/reduce_job.cpp", "farthest")):
            with self.subTest(file=file):
                self.setUp()
                path = self.root / name
                path.write_text(path.read_text(encoding="utf-8").replace("\n#undef", f"\n{row}\n#undef", 1))
                for _ in range(2):
                    code, text = self.lists()
                    self.assertEqual(code, 1, text)
                    self.assertIn(f"{file} has no `{said}`", text)
                with (self.root / file).open("a", encoding="utf-8") as at:
                    at.write(f"// {said}\n")
                self.assertNotIn(file, self.lists()[1])

    def test_a_table_that_was_edited_by_hand_is_stale(self):
        page = self.root / "protocol/PROTOCOL.md"
        page.write_text(page.read_text(encoding="utf-8").replace("| 12 | BUSY |", "| 12 | IDLE |"))
        self.assertEqual(self.lists("--check")[0], 1)

    def test_a_row_that_does_not_end_is_named(self):
        path = self.root / "protocol/lists/limits.def"
        path.write_text('RAYNEST_LIMIT(frame_bytes_max, 64, fixed, "one"')
        code, text = self.lists("--check")
        self.assertEqual(code, 1)
        self.assertIn("does not end", text)


class Integrators(unittest.TestCase):
    """An integrator is named in its row alone: clients and daemon know by it what they need."""

    def test_only_the_list_names_them(self):
        rows = (HERE.parent / "engine/integrators/integrators.def").read_text(encoding="utf-8")
        # "path" is a word of instances, too.
        names = set(re.findall(r"^RAYNEST_INTEGRATOR\((\w+)", rows, re.MULTILINE)) - {"path"}
        self.assertGreaterEqual(len(names), 2)
        named = [path for folder in ("server", "client", "engine") for path in (HERE.parent / folder).rglob("*")
                 if path.suffix in (".h", ".cpp", ".js") and path.name != "lists.js"
                 and re.search(rf'"({"|".join(names)})"', path.read_text(encoding="utf-8"))]
        self.assertEqual(named, [])


    def test_only_the_list_and_the_integrator_name_a_setting(self):
        rows = (HERE.parent / "engine/integrators/integrator_settings.def").read_text(encoding="utf-8")
        # "depth" is a word of other things, too.
        names = set(re.findall(r"^RAYNEST_INTEGRATOR_SETTING\((\w+)", rows, re.MULTILINE)) - {"depth"}
        self.assertGreaterEqual(len(names), 1)
        words = names | {name.replace("_", "-") for name in names} | {re.sub("_(.)", lambda m: m[1].upper(), name) for name in names}
        named = sorted(path.name for folder in ("server", "client", "engine", "protocol") for path in (HERE.parent / folder).rglob("*")
                       if path.suffix in (".h", ".cpp", ".js", ".py", ".def") and path.name not in ("lists.js", "_lists.py")
                       and re.search(rf"\b({'|'.join(words)})\b", path.read_text(encoding="utf-8")))
        self.assertEqual(named, ["ao.h", "integrator_settings.def", "integrators.def"])


class ServerReadme(unittest.TestCase):
    """server/README.md names functions on the way of a ray and files to edit: all of them exist."""

    ROOT = HERE.parent
    TEXT = (ROOT / "server/README.md").read_text(encoding="utf-8")

    def rows_below(self, title):
        return self.TEXT[self.TEXT.index(title):].split("\n\n")[0]

    def test_each_function_is_defined_and_their_number_is_right(self):
        names = re.findall(r"`([\w:]+)`", self.rows_below("| thread | stage |"))
        self.assertEqual([len(names)], [int(n) for n in re.findall(r"these (\d+) functions", self.TEXT)])
        code = "\n".join(path.read_text(encoding="utf-8") for folder in ("server", "protocol", "engine")
                         for path in (self.ROOT / folder).rglob("*") if path.suffix in (".h", ".cpp"))
        for name in names:
            scope, _, function = name.rpartition("::")
            with self.subTest(name=name):
                self.assertRegex(code, rf"\b{function}\(")
                if scope:
                    self.assertRegex(code, rf"\b(class|struct|namespace)\b.*\b{scope}\b")

    def test_each_file_to_edit_is_there(self):
        rows = self.rows_below("| to add | edit |")
        self.assertEqual(len(rows.splitlines()), 18)
        for row in rows.splitlines()[2:]:
            names = re.findall(r"`([\w./]*/[\w./]+)`", row)
            self.assertTrue(0 < len(names) <= 8, row)
            for name in names:
                self.assertTrue((self.ROOT / name).exists(), name)

    def test_the_row_of_a_list_names_what_its_rows_need(self):
        rows = self.rows_below("| to add | edit |").splitlines()
        spec = importlib.util.spec_from_file_location("lists", self.ROOT / ".ci/lists.py")
        lists = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(lists)
        for _, listed, file, _ in lists.NEEDS:
            self.assertTrue(any(f"`{listed}`" in row and f"`{file}`" in row for row in rows), (listed, file))

    def test_new_rows_test_adds_one_of_each_row_of_the_guide(self):
        text = (self.ROOT / "tests/added_rows.py").read_text(encoding="utf-8")
        added = set(re.findall(r"^def add_(\w+)\(tree\)", text, re.M))
        self.assertEqual(added, set(re.findall(r"add_(\w+)", text[text.index("ADDITIONS = "):])))
        several = {"shading": {"material", "lobe of a material", "light"}, "look": {"tone map", "palette"},
                   "kernels": {"intersector", "primitive"}}
        added = (added - several.keys()).union(*several.values())
        in_guide = set(re.findall(r"^\| an? ([a-z ]+?) \|", self.rows_below("| to add | edit |"), re.M))
        self.assertEqual(in_guide, added)


if __name__ == "__main__":
    unittest.main()
