#include "server/options.h"

#include "../../temporary_folder.h"

#include <doctest/doctest.h>

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
    return parse_options(static_cast<int>(argv.size()), argv.data());
}

TEST_CASE("without arguments the defaults fit this machine") {
    const auto parsed = parse({});
    REQUIRE(parsed.options);
    CHECK(parsed.options->listen == std::vector<std::string>{"tcp://127.0.0.1:31060"});
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
}

TEST_CASE("a usage error is exit code 2") {
    for (const std::vector<const char*>& arguments : {std::vector<const char*>{"--threads", "0"},
                                                      {"--threads", "many"},
                                                      {"--memory", "1"},
                                                      {"--memory", "-1"},
                                                      {"--target", "v5"},
                                                      {"--listen", "tcp://0.0.0.0:1"},
                                                      {"--http", "127.0.0.1:1"},
                                                      {"--scene-root", "/does/not/exist"},
                                                      {"--log-level", "loud"},
                                                      {"--config", "/does/not/exist"},
                                                      {"--unknown"},
                                                      {"--principal_jobs_max", "5"},
                                                      {"--socket-mode", "0060"},
                                                      {"--socket-mode", "0780"},
                                                      {"--socket-mode", "rw"},
                                                      {"--socket-group", "no-such-group"},
                                                      {"stray"}}) {
        const auto parsed = parse(arguments);
        CHECK_FALSE(parsed.options);
        CHECK(parsed.exit_code == 2);
    }
}

/// What is written to stderr while an argument list is refused.
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

/// A configuration file in a folder of its own, and what parsing it says on stderr.
class ConfigFile {
public:
    explicit ConfigFile(const std::string& text) { std::ofstream(path_) << text; }
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
    std::string path_ = folder_.path() / "raynestd.conf";
    std::string complaint_;
};

TEST_CASE("a configuration file is read, and its repeated lines add up") {
    ConfigFile file("# mine\nthreads=3\nlisten=unix:/tmp/a\n\nmemory=\"2G\"\nlisten=unix:/tmp/b\n");
    const auto parsed = file.read();
    REQUIRE_MESSAGE(parsed.options, file.complaint());
    CHECK(parsed.options->threads == 3);
    CHECK(parsed.options->memory == 2ULL << 30);
    CHECK(parsed.options->listen == std::vector<std::string>{"unix:/tmp/a", "unix:/tmp/b"});
}

TEST_CASE("a fault of a configuration file names its file, its line and its key") {
    struct Case {
        const char* text;
        const char* line;
        const char* key;
    };
    for (const Case& wrong :
         {Case{"threads=2\nthrads=3\n", "line 2", "'thrads'"},
          Case{"# all\n\nthreads=many\n", "line 3", "threads"},
          Case{"target=v9\n", "line 1", "target"}, Case{"[net]\nthreads=1\n", "line 1", "section"},
          Case{"config=/tmp/other\n", "line 1", "'config'"}}) {
        ConfigFile file(wrong.text);
        const auto parsed = file.read();
        CHECK_FALSE(parsed.options);
        CHECK(parsed.exit_code == 2);
        for (const std::string& word :
             {file.path(), std::string(wrong.line), std::string(wrong.key)})
            CHECK_MESSAGE(file.complaint().find(word) != std::string::npos, file.complaint());
    }
}

}  // namespace
}  // namespace raynest::server
