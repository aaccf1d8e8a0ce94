#include "server/options/options.h"

#include "../../temporary_folder.h"
#include "server/options/limits_in_force.h"

#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

ParsedOptions parse(const std::vector<const char*>& arguments) {
    std::vector<const char*> argv = {"raynestd"};
    for (const char* argument : arguments) argv.push_back(argument);
    return parse_options(static_cast<int>(argv.size()), argv.data(), std::cerr);
}

TEST_CASE("without arguments the defaults fit this machine") {
    const auto parsed = parse({});
    REQUIRE(parsed.options);
    CHECK(parsed.options->listen == std::vector<std::string>{"tcp://127.0.0.1:31060"});
    CHECK(parsed.options->http.address == "127.0.0.1:31061");
    CHECK_FALSE(parsed.options->http.given);
    CHECK(parsed.options->threads >= 1);
    CHECK(parsed.options->memory > (1ULL << 28));
    CHECK(parsed.options->log_level == LogLevel::info);
}

TEST_CASE("options are taken as given") {
    const auto parsed =
        parse({"--listen", "unix:/tmp/a", "--listen", "tcp://[::1]:0", "--threads", "3", "--memory",
               "2G", "--log-level", "debug", "--http", "off", "--state", "/tmp/s"});
    REQUIRE(parsed.options);
    CHECK(parsed.options->listen == std::vector<std::string>{"unix:/tmp/a", "tcp://[::1]:0"});
    CHECK(parsed.options->threads == 3);
    CHECK(parsed.options->memory == 2ULL << 30);
    CHECK(parsed.options->log_level == LogLevel::debug);
    CHECK(parsed.options->state == "/tmp/s");
    CHECK(parsed.options->http.address == "off");
    const auto hosts =
        parse({"--http", "[::1]:0", "--http-host", "ray.example", "--http-host", "a:80"});
    REQUIRE(hosts.options);
    CHECK(hosts.options->http.given);
    CHECK(hosts.options->http.hosts == std::vector<std::string>{"ray.example", "a:80"});
}

TEST_CASE("a usage error is exit code 2") {
    for (const std::vector<const char*>& arguments :
         {std::vector<const char*>{"--threads", "0"},
          {"--threads", "many"},
          {"--memory", "1"},
          {"--memory", "-1"},
          {"--target", "v5"},
          {"--listen", "tcp://0.0.0.0:1"},
          {"--listen", "tls://127.0.0.1:1"},
          {"--listen", "tls://0.0.0.0:1", "--tls-cert", "c", "--tls-key", "k"},
          {"--tls-cert", "c"},
          {"--client-ca", "c"},
          {"--anonymous", "admin"},
          {"--http", "127.0.0.1"},
          {"--http", "ftp://127.0.0.1:1"},
          {"--http", "https://127.0.0.1:1"},
          {"--http", "https://0.0.0.0:1"},
          {"--http", "0.0.0.0:31061"},
          {"--http", "192.0.2.1:31061"},
          {"--http", "example.org:31061"},
          {"--http-host", ""},
          {"--http-host", "a/b"},
          {"--http-host", "a:port"},
          {"--scene-root", "/does/not/exist"},
          {"--log-level", "loud"},
          {"--config", "/does/not/exist"},
          {"--unknown"},
          {"--principal_jobs_max", "5"},
          {"--socket-mode", "0060"},
          {"--socket-mode", "0780"},
          {"--socket-mode", "rw"},
          {"--socket-group", "no-such-group"},
          {"--socket-group", "4294967295"},
          {"stray"}}) {
        const auto parsed = parse(arguments);
        CHECK_FALSE(parsed.options);
        CHECK(parsed.exit_code == 2);
    }
}

/// Returns the text on stderr when an argument list is refused.
std::string complaint(const std::vector<const char*>& arguments) {
    std::ostringstream text;
    std::streambuf* const before = std::cerr.rdbuf(text.rdbuf());
    const auto parsed = parse(arguments);
    std::cerr.rdbuf(before);
    CHECK(parsed.exit_code == 2);
    return text.str();
}

bool mentions(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

TEST_CASE("beyond loopback a listener is encrypted and asks who comes") {
    const auto with_tls = [](std::vector<const char*> more) {
        std::vector<const char*> all = {"--listen", "tls://0.0.0.0:1", "--tls-cert",
                                        "c",        "--tls-key",       "k"};
        all.insert(all.end(), more.begin(), more.end());
        return parse(all);
    };
    CHECK(with_tls({"--tokens", "t"}).options);
    CHECK(with_tls({"--client-ca", "t"}).options);
    CHECK_FALSE(with_tls({"--insecure"}).options);
    CHECK(parse({"--listen", "tcp://0.0.0.0:1", "--insecure"}).options);
    CHECK(parse({"--listen", "tls://127.0.0.1:1", "--tls-cert", "c", "--tls-key", "k"}).options);
    CHECK(mentions(complaint({"--listen", "tcp://0.0.0.0:1"}), "--insecure"));
    CHECK(parse({}).options->security.anonymous == Role::user);
    CHECK_FALSE(parse({"--anonymous", "off"}).options->security.anonymous);
}

TEST_CASE("limits are spelled with hyphens, and the old spelling names the new one") {
    CHECK(parse({"--principal-jobs-max", "5"}).options->limits.principal_jobs_max == 5);
    for (const auto& arguments : {std::vector<const char*>{"--principal_jobs_max", "5"},
                                  {"--principal_jobs_max=5"},
                                  {"--log_level", "debug"}})
        CHECK(mentions(complaint(arguments), "is now spelled --"));
    CHECK(mentions(complaint({"--principal_jobs_max=5"}), "--principal-jobs-max"));
}

TEST_CASE("a socket is opened to a group by its name or number") {
    CHECK(parse({}).options->socket.mode == 0600);
    CHECK_FALSE(parse({}).options->socket.group);
    const auto root = parse({"--socket-group", "root"});
    CHECK(root.options->socket.group == 0);
    CHECK(root.options->socket.mode == 0660);
    const auto both = parse({"--socket-group", "17", "--socket-mode", "0600"});
    CHECK(both.options->socket.group == 17);
    CHECK(both.options->socket.mode == 0600);
    CHECK(mentions(complaint({"--socket-mode", "0860"}), "'0860' is not a mode"));
    CHECK(mentions(complaint({"--socket-group", "nobody-there"}), "no group 'nobody-there'"));
}

/// A configuration file in a folder of its own, and the text on stderr when it is parsed.
class ConfigFile {
public:
    explicit ConfigFile(const std::string& text) : path_(folder_.path() / "raynestd.toml") {
        std::ofstream(path_) << text;
    }
    [[nodiscard]] const std::string& path() const { return path_; }
    ParsedOptions read() {
        std::ostringstream said;
        std::streambuf* const before = std::cerr.rdbuf(said.rdbuf());
        const auto parsed = parse({"--config", path_.c_str()});
        std::cerr.rdbuf(before);
        complaint_ = said.str();
        return parsed;
    }
    [[nodiscard]] const std::string& complaint() const { return complaint_; }

private:
    test::TemporaryFolder folder_;
    std::string path_;
    std::string complaint_;
};

TEST_CASE("a configuration file in TOML is read, and a fault names file, line and key") {
    ConfigFile file(
        "# mine\nthreads = 3\nmemory = \"2G\"\nlisten = [\"unix:/tmp/a\", 'unix:/tmp/b']\n"
        "tokens = \"t\"\ninsecure = true\n");
    const auto parsed = file.read();
    REQUIRE_MESSAGE(parsed.options, file.complaint());
    CHECK(parsed.options->threads == 3);
    CHECK(parsed.options->memory == 2ULL << 30);
    CHECK(parsed.options->listen == std::vector<std::string>{"unix:/tmp/a", "unix:/tmp/b"});
    // A relative path begins at the folder of the file.
    const std::filesystem::path folder = std::filesystem::path(file.path()).parent_path();
    CHECK(parsed.options->security.tokens == folder / "t");
    CHECK(parsed.options->security.insecure);
    struct Case {
        const char* text;
        const char* line;
        const char* fault;
    };
    for (const Case& wrong :
         {Case{"threads = 2\nthrads = 3\n", "line 2", "no option 'thrads'"},
          Case{"\n\nthreads = \"many\"\n", "line 3", "threads"},
          Case{"threads = 1\nthreads = 2\n", "line 2", "threads"},
          Case{"threads = [1, 2]\n", "line 1", "takes one value"},
          Case{"[net]\nthreads = 1\n", "line 1", "is a section"},
          Case{"state = [[1]]\n", "line 1", "'state' is neither a string"},
          Case{"state = [ ]\n", "line 1", "'state' has no value"},
          Case{"threads = \n", "line 1", "value"},
          Case{"config = \"/tmp/other\"\n", "line 1", "no option 'config'"},
          Case{"state = \"/tmp/\x01\"\n", "line 1", "control character"},
          Case{"log_level = \"info\"\n", "line 1", "is now spelled 'log-level'"},
          // What a file of KEY=VALUE has, which earlier versions took.
          Case{"target=v9\n", "line 1", "a file is TOML: KEY = \"VALUE\""},
          Case{"listen=\"unix:a\"\nlisten=\"unix:b\"\n", "line 2", "as [\"ONE\", \"TWO\"]"}}) {
        ConfigFile bad(wrong.text);
        CHECK_FALSE(bad.read().options);
        for (const char* word : {wrong.line, wrong.fault})
            CHECK_MESSAGE(mentions(bad.complaint(), word), bad.complaint());
        CHECK(mentions(bad.complaint(), bad.path()));
    }
}

TEST_CASE("the environment wins over the file, and the command line over both") {
    ConfigFile file("threads = 3\nlog-level = \"error\"\n");
    setenv("RAYNEST_THREADS", "4", 1);
    CHECK(file.read().options->threads == 4);
    CHECK(file.read().options->log_level == LogLevel::error);
    CHECK(parse({"--config", file.path().c_str(), "--threads", "5"}).options->threads == 5);
    setenv("RAYNEST_GIVE_WAY_MS", "77", 1);
    CHECK(file.read().options->limits.give_way_ms == 77);
    CHECK(parse({"--give-way-ms", "78"}).options->limits.give_way_ms == 78);
    unsetenv("RAYNEST_GIVE_WAY_MS");
    setenv("RAYNEST_THREADS", "", 1);
    CHECK(file.read().options->threads == 3);
    setenv("RAYNEST_THREADS", "many", 1);
    CHECK(mentions(complaint({}), "RAYNEST_THREADS"));
    unsetenv("RAYNEST_THREADS");
}

TEST_CASE("relative paths of a configuration file begin at its folder, and words stay") {
    ConfigFile file(
        "state = 's/t'\nlisten = ['unix:../a', 'tcp://127.0.0.1:1']\nready-file = '/r'\n"
        "cuda = 'off'\nhttp = 'off'\n");
    const auto parsed = file.read();
    REQUIRE_MESSAGE(parsed.options, file.complaint());
    const std::filesystem::path folder = std::filesystem::path(file.path()).parent_path();
    CHECK(parsed.options->state == folder / "s" / "t");
    CHECK(parsed.options->listen ==
          std::vector<std::string>{std::string("unix:") + (folder.parent_path() / "a").string(),
                                   "tcp://127.0.0.1:1"});
    CHECK(parsed.options->ready_file == "/r");
    CHECK(parse({"--state", "s"}).options->state == "s");
}

TEST_CASE("a configuration is checked without a daemon") {
    ConfigFile good(
        "threads = 3\nhttp = \"off\"\ntrusted-proxy = \"10.0.0.0/8\"\n"
        "load = [\"builtin:flake\", \"/nowhere/*.glb\"]\n");
    std::ostringstream said;
    std::streambuf* const before = std::cout.rdbuf(said.rdbuf());
    const auto checked = parse({"--config", good.path().c_str(), "--check-config"});
    std::cout.rdbuf(before);
    CHECK_FALSE(checked.options);
    CHECK(checked.exit_code == 0);
    CHECK(mentions(said.str(), "is valid"));
    CHECK(mentions(said.str(), "warning: --load finds no file /nowhere/*.glb\n"));
    CHECK_FALSE(mentions(said.str(), "finds no file builtin"));
    CHECK(mentions(said.str(), "warning: --http-host and --trusted-proxy have no effect"));
    ConfigFile bad("listen = \"tcp://0.0.0.0:1\"\n");
    const std::string fault = complaint({"--config", bad.path().c_str(), "--check-config"});
    CHECK(mentions(fault, bad.path() + ", line 1: listen tcp://0.0.0.0:1 can be reached"));
    CHECK(mentions(fault, "or pass insecure"));
}

TEST_CASE("what --print-config writes is read back") {
    const std::string odd = "/tmp/a # \"b\" c\\d 'e'";
    std::ostringstream printed;
    std::streambuf* const before = std::cout.rdbuf(printed.rdbuf());
    const auto answered = parse({"--print-config", "--ready-file", odd.c_str(), "--memory", "3G",
                                 "--listen", "unix:/tmp/a", "--listen", "unix:/tmp/b"});
    std::cout.rdbuf(before);
    CHECK(answered.exit_code == 0);
    ConfigFile file(printed.str());
    const auto parsed = file.read();
    REQUIRE_MESSAGE(parsed.options, file.complaint());
    CHECK(parsed.options->ready_file == odd);
    CHECK(parsed.options->listen == std::vector<std::string>{"unix:/tmp/a", "unix:/tmp/b"});
    CHECK(parsed.options->memory == 3ULL << 30);
}

TEST_CASE("a size may have a fraction and a unit, and says what it should be") {
    CHECK(parse({"--memory", "1.5G"}).options->memory == 3ULL << 29);
    CHECK(parse({"--memory", "64 MiB"}).options->memory == 64ULL << 20);
    CHECK(parse({"--memory", "2000000"}).options->memory == 2'000'000);
    CHECK(parse({"--principal-scene-bytes-max", "20G"}).options->limits.principal_scene_bytes_max ==
          20ULL << 30);
    CHECK(mentions(complaint({"--principal-scene-bytes-max", "20X"}),
                   "is not a number of bytes, such as"));
    CHECK_FALSE(complaint({"--principal-jobs-max", "1K"}).empty());
    for (const char* wrong : {"abc", "8X", "8GG", "1K", "2P", "nan", "1e400"})
        CHECK(mentions(complaint({"--memory", wrong}), "is not a size from 1M to 1P"));
}

TEST_CASE("no address is listened on twice, but a free port may be picked twice") {
    CHECK(mentions(complaint({"--listen", "tcp://localhost:9", "--listen", "tcp://127.0.0.1:9"}),
                   "'tcp://127.0.0.1:9' is given twice"));
    CHECK(parse({"--listen", "tcp://[::1]:0", "--listen", "tcp://[::1]:0"}).options);
}

TEST_CASE("a fault in the environment names its variable") {
    setenv("RAYNEST_TARGET", "v9", 1);
    CHECK(mentions(complaint({}), "RAYNEST_TARGET: v9"));
    unsetenv("RAYNEST_TARGET");
}

TEST_CASE("quotas of bytes are by default shares of --memory") {
    const auto parsed = [](const std::vector<const char*>& arguments) {
        return limits_in_force(*parse(arguments).options);
    };
    const protocol::Limits usual = parsed({"--memory", "1G"});
    CHECK(usual.principal_scene_bytes_max == 512 << 20);
    CHECK(usual.principal_result_bytes_max == 128 << 20);
    const protocol::Limits given =
        parsed({"--memory", "1G", "--principal-scene-bytes-max", "900M"});
    CHECK(given.principal_scene_bytes_max == 900 << 20);
    CHECK(given.principal_result_bytes_max == 128 << 20);
    const std::uint64_t without_state = protocol::Limits().principal_disk_bytes_max;
    CHECK(usual.principal_disk_bytes_max == without_state);
    CHECK(parsed({"--state", "/tmp"}).principal_disk_bytes_max ==
          std::filesystem::space("/tmp").capacity / 2);
    CHECK(
        parsed({"--state", "/tmp", "--principal-disk-bytes-max", "5G"}).principal_disk_bytes_max ==
        5ULL << 30);
}

}  // namespace
}  // namespace raynest::server
